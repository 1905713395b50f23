// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The paper's figure 2 for authors in C++: a NodeHandle whose topics are ports.
///
/// Code that is written with it builds with this header alone and runs without DyKnow as well, where its topics
/// stay where remappings put them and the callback is never called.
#ifndef DYKNOW_NODE_HANDLE_H
#define DYKNOW_NODE_HANDLE_H

#include <dlfcn.h>
#include <ros/node_handle.h>

#include <functional>
#include <map>
#include <string>
#include <utility>

namespace dyknow
{

/// Topics by port; an empty topic: the port is disconnected.
using PortTopics = std::map<std::string, std::string>;

/// Called with the in-ports and the out-ports after they were connected elsewhere.
using ReconfigureCallback = std::function<void(const PortTopics& inputs, const PortTopics& outputs)>;

/// A ros::NodeHandle; its publishers and subscribers are the ports of its node or nodelet.
class NodeHandle : public ros::NodeHandle
{
public:
  using ros::NodeHandle::NodeHandle;

  /// Uses the names and the callback queue of another handle, such as `getNodeHandle()` of a nodelet.
  NodeHandle(const ros::NodeHandle& other)  // NOLINT: converts as ros::NodeHandle does
    : ros::NodeHandle(other)
  {
  }

  /// Sets the callback of the node or nodelet. It is called in the handle's callback queue, between the last
  /// message of the old topics and the first one of a new topic; an exception in it is logged, and the ports stay
  /// where they are.
  ///
  /// @param callback an empty one: nothing is called any more
  /// @return whether the ports can be connected elsewhere
  bool setReconfigureCallback(ReconfigureCallback callback)
  {
    // Looked up, so that nothing has to be linked with, and without the library nothing is missing.
    using Set = bool (*)(ros::NodeHandle&, ReconfigureCallback);
    const auto set = reinterpret_cast<Set>(dlsym(RTLD_DEFAULT, "dyknow_set_reconfigure_callback"));
    return set != nullptr && set(*this, std::move(callback));
  }
};

}  // namespace dyknow

#endif
