// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Names of topics and of ports.
#ifndef DYKNOW_ROSCPP_NAMES_H
#define DYKNOW_ROSCPP_NAMES_H

#include <map>
#include <string>

namespace dyknow::names
{

/// Namespace of a global name: `/robot` for `/robot/camera`, `/` at the root.
std::string parent(const std::string& name);

/// Appends a relative name to a namespace.
std::string join(const std::string& space, const std::string& name);

/// Whether a global name is below a namespace.
bool isBelow(const std::string& name, const std::string& space);

/// Whether a topic is one that a manager remaps ports of a node to so that they begin disconnected.
bool isDisconnected(const std::string& topic, const std::string& node);

/// Makes the global name of a topic from a user's text. Raises Refusal if it is none.
///
/// @param node the meaning of a leading `~`; relative names begin in its namespace.
std::string topicOf(const std::string& text, const std::string& node);

/// Takes remappings back: the name of a topic before `remappings` (global to global) applied to it,
/// or to a namespace that it is in.
std::string beforeRemapping(const std::string& name, const std::map<std::string, std::string>& remappings);

/// Name of the port for a global name that was written relatively, in a handle of its node or nodelet:
/// relative to the node's namespace, private with `~`, else global.
std::string portOf(const std::string& name, const std::string& node);

/// The name of a port without the `~` or `/` that says where it begins.
std::string base(const std::string& port);

/// The image whose messages a topic, or a port, of image_transport has in another form; empty if it is none.
std::string imageOf(const std::string& name);

/// The global name of a port, before any remapping; empty of an empty one.
std::string globalOf(const std::string& port, const std::string& node);

}  // namespace dyknow::names

#endif
