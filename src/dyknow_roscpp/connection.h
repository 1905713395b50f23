// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file One subscription's link to one topic.
#ifndef DYKNOW_ROSCPP_CONNECTION_H
#define DYKNOW_ROSCPP_CONNECTION_H

#include <ros/callback_queue_interface.h>
#include <ros/subscription_callback_helper.h>

#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

namespace dyknow
{

class PortSubscription;

/// What roscpp takes for the callback of a subscription and for the callback queue that it goes to.
///
/// roscpp clears the queue of a subscription when it ends. A connection of our own for each topic lets the
/// old topic's messages be delivered after that: `removeByID` does nothing, and the hook of
/// `SubscriptionQueue::clear` keeps the messages.
class Connection final : public ros::SubscriptionCallbackHelper, public ros::CallbackQueueInterface
{
public:
  /// A connection goes from one state to the next, or leaves some out.
  enum class State
  {
    HELD,      ///< the move is not decided: messages are queued, callbacks are kept back
    WAITING,   ///< moving: its first message switches the subscription over to it
    OPEN,      ///< delivers
    DRAINING,  ///< takes no more, and delivers what it holds
    CLOSED     ///< delivers nothing any more
  };

  Connection(std::weak_ptr<PortSubscription> subscription, ros::SubscriptionCallbackHelperPtr original,
             ros::CallbackQueueInterface* queue, std::string topic, State state);

  const std::string topic;

  // ros::SubscriptionCallbackHelper
  ros::VoidConstPtr deserialize(const ros::SubscriptionCallbackHelperDeserializeParams& params) override;
  void call(ros::SubscriptionCallbackHelperCallParams& params) override;
  const std::type_info& getTypeInfo() override;
  bool isConst() override;
  bool hasHeader() override;

  // ros::CallbackQueueInterface
  void addCallback(const ros::CallbackInterfacePtr& callback, std::uint64_t) override;
  void removeByID(std::uint64_t) override {}

  /// Takes a message in place of roscpp's queue; `push` does what roscpp would have done and returns whether
  /// the queue was full. Returns true if roscpp must not queue a callback.
  template <class Push>
  bool take(Push push);

private:
  friend class PortSubscription;

  /// Queues one more callback for a message of it.
  void queueCallback();

  const std::weak_ptr<PortSubscription> subscription_;
  const ros::SubscriptionCallbackHelperPtr original_;
  ros::CallbackQueueInterface* const queue_;

  // All that follows is guarded by the lock of the subscription.
  State state_;
  ros::CallbackInterfacePtr callback_;  ///< roscpp's, the same for each message
  std::size_t held_back_ = 0;           ///< callbacks that have not gone to the queue
  std::size_t queued_ = 0;              ///< messages that wait
  std::size_t skipped_ = 0;             ///< the first of them, which another connection took as well
  std::vector<std::thread::id> running_;
};

using ConnectionPtr = boost::shared_ptr<Connection>;

}  // namespace dyknow

#endif
