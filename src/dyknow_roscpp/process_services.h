// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The services of proxies and of the process, and the announcement of changes.
///
/// They have callback queues and threads of their own: a nodelet whose callback hangs can be looked at and
/// re-wired.
#ifndef DYKNOW_ROSCPP_PROCESS_SERVICES_H
#define DYKNOW_ROSCPP_PROCESS_SERVICES_H

#include <ros/callback_queue_interface.h>

#include <memory>
#include <string>

#include "nodelet_proxy.h"

namespace dyknow
{

/// Offers get_config, set_config and get_statistics in the name of a nodelet, and `~poll`, and announces it; once
/// is enough, however often roscpp is shut down and started again.
void offerServices(const std::shared_ptr<NodeletProxy>& proxy);

/// Withdraws them, and announces it.
void withdrawServices(NodeletProxy& proxy);

/// Withdraws the services that the handles of a callback queue offer.
void withdrawServicesOf(const ros::CallbackQueueInterface* queue);

/// Offers a nodelet manager's own services: `~poll` and the announcement of changes.
void offerManagerServices();

/// Offers again what `offerServices` has offered: a shutdown of roscpp withdraws all of it. To be called after
/// each start.
void offerServicesAgain();

/// Makes room for a service of the own code of a node or nodelet: if it has the name of one of these, it wins,
/// which is logged.
void giveWay(const std::string& service, const std::string& owner);

/// Whether a service is our `~poll`, which is not registered: DyKnow managers look up another one of the
/// process.
bool isOwnService(const std::string& service);

/// Whether a topic is one of those that the process offers.
bool isOwnTopic(const std::string& topic);

/// Announces that a nodelet, or a port of it, has changed; returns at once.
void announceChange(const std::string& nodelet);

}  // namespace dyknow

#endif
