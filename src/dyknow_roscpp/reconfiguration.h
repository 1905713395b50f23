// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file How the code of a node or nodelet hears that its ports were connected elsewhere.
#ifndef DYKNOW_ROSCPP_RECONFIGURATION_H
#define DYKNOW_ROSCPP_RECONFIGURATION_H

#include <ros/callback_queue_interface.h>

#include <functional>
#include <memory>
#include <mutex>

#include "dyknow/node_handle.h"

namespace dyknow
{

/// Puts a call of the node's callback into its queue; only the first time that it is called.
using Announcement = std::function<void()>;

/// The callback of one node or nodelet. Every method is safe from any thread.
class ReconfigureListener : public std::enable_shared_from_this<ReconfigureListener>
{
public:
  /// @param queue where it is called; it lives until `close`
  void set(ReconfigureCallback callback, ros::CallbackQueueInterface* queue);

  /// Calls nothing any more.
  void close() { set(nullptr, nullptr); }

  Announcement announcement(PortTopics inputs, PortTopics outputs);

  /// Calls it with these topics, if it is still there.
  void call(const PortTopics& inputs, const PortTopics& outputs) const;

private:
  void queue(const PortTopics& inputs, const PortTopics& outputs);

  mutable std::mutex state_lock_;
  ReconfigureCallback callback_;
  ros::CallbackQueueInterface* queue_ = nullptr;
};

}  // namespace dyknow

#endif
