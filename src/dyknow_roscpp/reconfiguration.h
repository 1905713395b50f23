// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file How the code of a node or nodelet hears that its ports were connected elsewhere.
#ifndef DYKNOW_ROSCPP_RECONFIGURATION_H
#define DYKNOW_ROSCPP_RECONFIGURATION_H

#include <ros/callback_queue_interface.h>

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>

#include "dyknow/node_handle.h"

namespace dyknow
{

class ReconfigureListener;

/// Where the ports are after one change.
struct PortMaps
{
  std::uint32_t change;  ///< number of the change
  PortTopics inputs;
  PortTopics outputs;
};

/// Announces one change to the callback of a node or nodelet. Every method is safe from any thread.
class Announcement
{
public:
  Announcement(std::shared_ptr<ReconfigureListener> listener, PortMaps maps);

  /// Puts a call of the callback into its queue; only the first time that it is called.
  void make();

  /// Whether the callback is told of this change, perhaps by the announcement of a later one.
  bool isMade() const;

private:
  const std::shared_ptr<ReconfigureListener> listener_;
  const std::shared_ptr<const PortMaps> maps_;
  std::atomic<bool> is_made_{false};
};

using AnnouncementPtr = std::shared_ptr<Announcement>;

/// The callback of one node or nodelet. Every method is safe from any thread.
class ReconfigureListener : public std::enable_shared_from_this<ReconfigureListener>
{
public:
  /// @param queue where it is called; it lives until `close`
  void set(ReconfigureCallback callback, ros::CallbackQueueInterface* queue);

  /// Calls nothing any more.
  void close() { set(nullptr, nullptr); }

  bool isSet() const;

  /// Queues a call of it: with the maps of a later change, if that was queued before.
  void queue(const std::shared_ptr<const PortMaps>& maps);

  /// Number of the latest change of which a call was queued.
  std::uint32_t queued() const { return queued_; }

  /// Calls it with these maps, if it is still there.
  void call(const PortMaps& maps) const;

private:
  mutable std::mutex state_lock_;
  ReconfigureCallback callback_;
  ros::CallbackQueueInterface* queue_ = nullptr;
  std::shared_ptr<const PortMaps> latest_;  ///< those of the latest change that was queued
  std::atomic<std::uint32_t> queued_{0};
};

}  // namespace dyknow

#endif
