// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The object behind a ros::Publisher.
#ifndef DYKNOW_ROSCPP_PORT_PUBLICATION_H
#define DYKNOW_ROSCPP_PORT_PUBLICATION_H

#include <ros/advertise_options.h>
#include <ros/common.h>
#include <ros/serialized_message.h>
#include <ros/subscriber_link.h>

#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "port.h"
#include "topics.h"

namespace dyknow
{

/// The subscribers of a topic in other processes: all publications of this process share them.
class Audience
{
public:
  /// @param addresses of those that the master knew
  void expect(std::set<std::string> addresses);

  void connected(const std::string& node);

  /// Whether all have connected; queries the master for the addresses of those that have since the last call.
  bool isComplete();

private:
  std::mutex state_lock_;
  bool is_awaiting_ = true;
  std::set<std::string> awaited_;   ///< addresses of those that have yet to connect
  std::vector<std::string> named_;  ///< names of those that have connected, while some are awaited
};

/// One publication's registration on one topic, with the links to its subscribers.
class Registration : public std::enable_shared_from_this<Registration>
{
public:
  /// @param owner name of the node or nodelet
  Registration(std::string topic, ros::SubscriberCallbacksPtr node, const std::string& owner);

  const std::string topic;
  /// The callbacks of roscpp, which call those of the node.
  const ros::SubscriberCallbacksPtr callbacks;

  /// Advertises. Raises Refusal if roscpp does not take it.
  void advertise(const topics::WiringLock& lock, ros::AdvertiseOptions options);
  void unadvertise(const topics::WiringLock& lock);

  /// Once it is advertised.
  void publish(const boost::function<ros::SerializedMessage()>& serialise, ros::SerializedMessage& message);
  void incrementSequence();

  /// Sends a serialised message to the subscribers that are connected, past roscpp's queue and numbers.
  void send(const ros::SerializedMessage& message) const;

  /// Delivers what roscpp's thread has not yet passed on.
  void flush() const;

  /// Calls the node's disconnect callback for each link: roscpp does not when a publisher unadvertises, and a
  /// lazy nodelet would go on working for no subscriber. The node hears of no links that come later.
  void disconnectAll();

  /// The owner of the registration whose latched message this thread sends; null: it sends none.
  static const std::string* latchedBy();

  /// Whether the subscribers have connected that the master knew when the process advertised the topic.
  bool isHeardByAll() const;

  /// Whether there is a link to another process, which still has to receive published messages.
  bool isHeardOutside() const;

private:
  void pushLatched(const ros::SubscriberLinkPtr& link) const;
  void connected(const ros::SubscriberLinkPtr& link);
  void disconnected(const ros::SubscriberLinkPtr& link);
  void queueForNode(const ros::SubscriberStatusCallback& callback, const ros::SubscriberLinkPtr& link) const;

  const ros::SubscriberCallbacksPtr node_;
  const std::string owner_;
  ros::PublicationPtr publication_;  ///< roscpp's, of all publishers of this process that are on the topic
  bool is_advertised_ = false;       ///< under the wiring lock
  std::shared_ptr<Audience> audience_;  ///< null before it is advertised
  mutable std::mutex links_lock_;
  bool is_withdrawn_ = false;
  std::vector<ros::SubscriberLinkPtr> links_;
};

using RegistrationPtr = std::shared_ptr<Registration>;

/// A publication of a node's code, connected to one topic or to none.
///
/// A move registers on the new topic, waits a while until its subscribers are connected, switches between two
/// messages, and withdraws the old registration when its messages are on their way.
///
/// Locks: the wiring lock, then `message_lock_`, then roscpp's, then `links_lock_`.
class PortPublication final : public End, public std::enable_shared_from_this<PortPublication>
{
public:
  explicit PortPublication(std::shared_ptr<Port> port);

  /// The node advertises; returns what roscpp is to answer.
  bool open(const ros::AdvertiseOptions& options, const ros::SubscriberCallbacksPtr& callbacks);

  /// The node lets go.
  void close();

  void publish(const boost::function<ros::SerializedMessage()>& serialise, ros::SerializedMessage& message);
  void incrementSequence();

  /// Subscribers that are connected, of the old and the new topic while it moves: a lazy nodelet must not
  /// stop in between.
  std::size_t subscribers() const;

  const Port& port() const { return *port_; }

  /// Whether a publication of this process is about to move to a topic: its messages still go to another one.
  static bool isAnyMovingTo(const std::string& topic);

  // End
  void prepare(const std::string& topic, Clock::time_point deadline, const OutTopics& outs) override;
  bool isReady() const override;
  bool commit(const AnnouncementPtr& announcement) override;
  void cancel() override;
  std::string topic() const override;
  bool isOpen() const override;
  Traffic traffic() const override;

private:
  /// Whether it has not been moved away meanwhile.
  bool isActive(const RegistrationPtr& registration) const;
  /// Under `message_lock_`: the node's queue, which is notified of lost subscribers, is there until
  /// close() has it.
  void withdrawLater(const RegistrationPtr& old);

  // What every message touches, side by side: it is seldom in the processor's caches any more.
  mutable std::mutex message_lock_;  ///< held while a message is published
  RegistrationPtr active_;
  bool is_open_ = false;
  bool is_latched_ = false;
  Traffic traffic_;

  const std::shared_ptr<Port> port_;
  ros::AdvertiseOptions options_;
  ros::SubscriberCallbacksPtr node_;
  std::uint32_t shutdowns_ = 0;  ///< of roscpp, before it was opened
  RegistrationPtr prepared_;
  std::shared_ptr<void> notice_;  ///< that it moves to the topic of `prepared_`, for `isAnyMovingTo`
  bool is_prepared_ = false;
  std::vector<RegistrationPtr> lingering_;
  ros::SerializedMessage passed_;  ///< the last one of those that are latched
};

}  // namespace dyknow

#endif
