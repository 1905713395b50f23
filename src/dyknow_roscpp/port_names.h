// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file How the port of a handle is called: as its node's own code calls the topic, before any remapping.
#ifndef DYKNOW_ROSCPP_PORT_NAMES_H
#define DYKNOW_ROSCPP_PORT_NAMES_H

#include <ros/node_handle.h>

#include <string>

#include "nodelet_proxy.h"

namespace dyknow
{

/// Names the port of a topic that the code of `owner` asks of a handle. Its namespace may have been remapped,
/// which is taken back. Code that keeps the options of a handle for the next one, as message_filters does,
/// asks for the resolved name then.
PortName namePort(NodeletProxy& owner, const ros::NodeHandle& handle, const std::string& topic,
                  Direction direction);

/// Notes that the code of `owner` has let roscpp resolve a name. A handle that advertises the resolved name
/// later, as image_transport does, is a port of the requested name.
void noteResolved(NodeletProxy& owner, const ros::NodeHandle& handle, const std::string& asked,
                  const std::string& resolved);

}  // namespace dyknow

#endif
