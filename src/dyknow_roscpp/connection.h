// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file One subscription's link to one topic.
#ifndef DYKNOW_ROSCPP_CONNECTION_H
#define DYKNOW_ROSCPP_CONNECTION_H

#include <ros/callback_queue_interface.h>
#include <ros/message_deserializer.h>
#include <ros/subscribe_options.h>
#include <ros/subscription_callback_helper.h>
#include <ros/time.h>

#include <cstdint>
#include <list>
#include <memory>
#include <string>

namespace dyknow
{

class Connection;
class PortSubscription;

using ConnectionPtr = boost::shared_ptr<Connection>;

/// A message that waits for its callback.
struct QueuedMessage
{
  ConnectionPtr connection;
  ros::MessageDeserializerPtr deserializer;
  ros::Time receipt_time;
  bool has_other_receivers;  ///< a callback that changes the message gets a copy
};

/// What roscpp takes for the callback of a subscription, and for the callback queue that it goes to.
///
/// roscpp has a queue of messages for each topic, and clears it when the subscription ends. Here all messages
/// go into one queue of the port's subscription, which outlives its connections: what came from the old topic
/// is delivered before the messages of the new one. A connection is also the callback that is queued for each
/// of its messages.
class Connection final : public ros::SubscriptionCallbackHelper,
                         public ros::CallbackQueueInterface,
                         public ros::CallbackInterface
{
public:
  /// A connection goes from one state to the next, or leaves some out.
  enum class State
  {
    HELD,     ///< the move is not decided: its messages are kept back
    WAITING,  ///< moving: its first message switches the subscription over to it
    OPEN,     ///< its messages are queued
    CLOSED    ///< takes no more
  };

  /// @param subscription lets go of the connection when it is closed, otherwise each would keep the other
  /// @param number index of this one among the subscription's connections was made first
  Connection(std::shared_ptr<PortSubscription> subscription, const ros::SubscribeOptions& options,
             std::string topic, std::uint32_t number, State state);

  /// Takes a message of it; returns what PortSubscription::take does.
  bool take(QueuedMessage&& message);

  // ros::SubscriptionCallbackHelper
  ros::VoidConstPtr deserialize(const ros::SubscriptionCallbackHelperDeserializeParams& params) override;
  void call(ros::SubscriptionCallbackHelperCallParams& params) override;
  const std::type_info& getTypeInfo() override;
  bool isConst() override;
  bool hasHeader() override;

  // ros::CallbackQueueInterface: the subscription has queued a callback when it took the message
  void addCallback(const ros::CallbackInterfacePtr&, std::uint64_t) override {}
  void removeByID(std::uint64_t) override {}

  // ros::CallbackInterface
  CallResult call() override;

private:
  friend class PortSubscription;

  // What every message touches comes first: it is seldom in the processor's caches any more.
  const std::shared_ptr<PortSubscription> subscription_;
  const ros::SubscriptionCallbackHelperPtr original_;
  const std::type_info& type_;
  ros::CallbackQueueInterface* const queue_;
  const std::uint32_t queue_size_;  ///< 0: any number of messages
  const std::uint32_t number_;

  // Guarded by the lock of the subscription.
  State state_;
  bool meets_own_ = false;  ///< during a change: an out-port of the nodelet comes to its topic, or leaves it
  std::uint32_t queued_ = 0;  ///< messages that wait
  std::list<QueuedMessage> held_;
  boost::weak_ptr<ros::MessageDeserializer> last_;  ///< of the message that came last

public:
  const std::string topic;
};

}  // namespace dyknow

#endif
