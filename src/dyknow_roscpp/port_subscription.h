// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The object behind a ros::Subscriber.
#ifndef DYKNOW_ROSCPP_PORT_SUBSCRIPTION_H
#define DYKNOW_ROSCPP_PORT_SUBSCRIPTION_H

#include <ros/subscribe_options.h>

#include <boost/container/small_vector.hpp>

#include <condition_variable>
#include <list>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "connection.h"
#include "port.h"
#include "topics.h"

namespace dyknow
{

/// A subscription of a node's code, connected to one topic or to none.
///
/// A move switches at the first message of the new topic. Until then the old topic is live, since its
/// publisher may be on its way to the new one as well; but no longer than 0.1 s if the new topic has a
/// publisher, 0.5 s if it has none, and not at all if an out-port of the same change comes to it. Nothing of it is
/// delivered once the change is announced to the node's code: another in-port of it may switch first.
///
/// Locks: the wiring lock, then roscpp's, then `queueing_lock_`, then `state_lock_`. Under both of these only
/// callback queues are called. The first is there for messages that come: a thread that their callback wakes
/// needs the second at once.
class PortSubscription final : public End, public std::enable_shared_from_this<PortSubscription>
{
public:
  explicit PortSubscription(std::shared_ptr<Port> port);

  /// The node subscribes; returns what roscpp is to answer.
  bool open(const ros::SubscribeOptions& options);

  /// The node lets go. As in roscpp, no callback runs any more on another thread when this returns.
  void close();

  /// Queues a message and a callback for it; returns whether one was lost: the oldest of a full queue, or this
  /// one if its connection is closed.
  bool take(QueuedMessage&& message);

  /// Calls the node with the next message, unless that is of a later connection than `latest`: callbacks are
  /// queued in reserve, and no message may come before the announcement of its connection.
  ros::CallbackInterface::CallResult deliver(const Connection& latest);

  /// Publishers that are connected.
  std::size_t publishers() const;

  const Port& port() const { return *port_; }

  // End
  void prepare(const std::string& topic, Clock::time_point deadline, const OutTopics& outs) override;
  void makeWay() override;
  bool commit(const AnnouncementPtr& announcement) override;
  void cancel() override;
  std::string topic() const override;
  bool isOpen() const override;
  Traffic traffic() const override;

private:
  /// Whether a message is, or may be, of an out-port that a connection meets during a change.
  bool isOwn(const QueuedMessage& message) const;
  /// Whether it has not been moved away meanwhile.
  bool isActive(const ConnectionPtr& connection) const;
  ConnectionPtr makeConnectionLocked(const std::string& topic, Connection::State state);
  /// Whether roscpp took it; false as well if the node has released its tracked object.
  bool registerConnection(const topics::WiringLock& lock, const ConnectionPtr& connection);
  /// Queues callbacks for messages of a connection.
  void queueCallbacks(const ConnectionPtr& connection, std::uint32_t count);
  std::uint64_t callbackId() const { return reinterpret_cast<std::uint64_t>(this); }
  bool isRunningElsewhereLocked() const;
  /// Delivers from `next` (null: from nothing) after the queued messages.
  void switchLocked(ConnectionPtr next);
  void switchIfDue(const ConnectionPtr& next, Clock::time_point committed);
  static void withdraw(const ConnectionPtr& connection);

  // What every message touches, side by side: it is seldom in the processor's caches any more.
  alignas(64) std::mutex queueing_lock_;
  mutable std::mutex state_lock_;
  std::list<QueuedMessage> queue_;                              ///< of one connection after the other
  boost::container::small_vector<std::thread::id, 1> running_;  ///< threads that run a callback
  bool is_open_ = false;
  bool is_tracked_ = false;
  Traffic traffic_;

  const std::shared_ptr<Port> port_;
  std::condition_variable callback_ended_;  ///< notified when it is closed
  ros::SubscribeOptions options_;
  std::uint32_t shutdowns_ = 0;  ///< of roscpp, before it was opened
  ros::VoidConstWPtr tracked_;  // held weakly: the node's object must be able to die
  std::uint32_t connections_ = 0;  ///< how many were made
  ConnectionPtr active_;
  ConnectionPtr waiting_;
  ConnectionPtr prepared_;
  bool is_prepared_ = false;
  bool stays_ = false;     ///< the prepared end is to stay on the topic of `active_`
  AnnouncementPtr announcement_;  ///< made at the next switch
};

}  // namespace dyknow

#endif
