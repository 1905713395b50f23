// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file What a ros::Subscriber has behind it.
#ifndef DYKNOW_ROSCPP_PORT_SUBSCRIPTION_H
#define DYKNOW_ROSCPP_PORT_SUBSCRIPTION_H

#include <ros/subscribe_options.h>

#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <string>

#include "connection.h"
#include "port.h"
#include "topics.h"

namespace dyknow
{

/// A subscription of a node's code, connected to one topic or to none.
///
/// A move switches at the first message of the new topic. Until then the old topic is live, since its
/// publisher may be on its way to the new one as well; but no longer than 0.1 s if the new topic has a
/// publisher, and 0.5 s if it has none.
///
/// Locks: the wiring lock, then roscpp's, then `queueing_lock_`, then `state_lock_`. Under both of these only
/// callback queues are called. The first is there for messages that come: who is woken up by their callback needs
/// the second at once.
class PortSubscription final : public End, public std::enable_shared_from_this<PortSubscription>
{
public:
  explicit PortSubscription(std::shared_ptr<Port> port);

  /// The node subscribes; returns what roscpp is to answer.
  bool open(const ros::SubscribeOptions& options);

  /// The node lets go. As in roscpp, no callback runs any more on another thread when this returns.
  void close();

  /// Publishers that are connected.
  std::size_t publishers() const;

  const Port& port() const { return *port_; }

  // End
  void prepare(const std::string& topic, Clock::time_point deadline) override;
  bool isReady() const override;
  bool commit(const Announcement& announce) override;
  void cancel() override;
  std::string topic() const override;
  bool isOpen() const override;

private:
  friend class Connection;

  /// Whether it has not been moved away meanwhile.
  bool isActive(const ConnectionPtr& connection) const;
  ConnectionPtr makeConnection(const std::string& topic, Connection::State state);
  /// Whether roscpp took it; false as well if the node has let go of what it tracks.
  bool registerConnection(const topics::WiringLock& lock, const ConnectionPtr& connection);
  void deliver(Connection& connection, ros::SubscriptionCallbackHelperCallParams& params);
  void awaitPredecessors(std::unique_lock<std::mutex>& lock, const Connection& connection);
  /// Delivers from `next` (null: from nothing) after what is queued.
  void switchLocked(ConnectionPtr next);
  void switchIfDue(const ConnectionPtr& next, Clock::time_point committed);
  void withdraw(const ConnectionPtr& connection);

  const std::shared_ptr<Port> port_;
  std::shared_ptr<Traffic> traffic_;

  std::mutex queueing_lock_;
  mutable std::mutex state_lock_;
  std::condition_variable callback_ended_;
  ros::SubscribeOptions options_;
  ros::VoidConstWPtr tracked_;  // held weakly: the node's object must be able to die
  bool is_tracked_ = false;
  bool is_open_ = false;
  ConnectionPtr active_;
  ConnectionPtr waiting_;
  ConnectionPtr prepared_;
  bool is_prepared_ = false;
  bool stays_ = false;                  ///< what is prepared is to stay on the topic of `active_`
  Announcement announce_;               ///< called at the next switch
  std::deque<ConnectionPtr> draining_;  ///< the oldest first
};

template <class Push>
bool Connection::take(Push push)
{
  const auto subscription = subscription_.lock();
  if (!subscription)
  {
    return true;
  }
  std::lock_guard<std::mutex> lock(subscription->state_lock_);
  if (state_ == State::WAITING)
  {
    subscription->switchLocked(subscription->waiting_);
  }
  if (state_ != State::OPEN && state_ != State::HELD)
  {
    return true;  // a full queue is what roscpp takes it for, and queues no callback
  }
  const bool was_full = push();
  if (was_full && skipped_ > 0)
  {
    --skipped_;  // that one has made room
  }
  else if (was_full)
  {
    subscription->traffic_->dropped();
  }
  else
  {
    ++queued_;
  }
  return was_full;
}

}  // namespace dyknow

#endif
