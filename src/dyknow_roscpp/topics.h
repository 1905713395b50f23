// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The topic manager of libroscpp that comes behind us, one change at a time.
#ifndef DYKNOW_ROSCPP_TOPICS_H
#define DYKNOW_ROSCPP_TOPICS_H

#include <ros/advertise_options.h>
#include <ros/common.h>
#include <ros/forwards.h>
#include <ros/serialized_message.h>
#include <ros/subscribe_options.h>
#include <xmlrpcpp/XmlRpcValue.h>

#include <cstdint>
#include <functional>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "traffic.h"

namespace dyknow::topics
{

/// Held over every registration: roscpp itself races when one thread subscribes while another unsubscribes or
/// advertises.
///
/// Callbacks never run under it (see DirectQueue), but destructors may, of the node's objects and of roscpp's
/// publisher of statistics, and these register too: the lock is recursive.
///
/// While the master is down roscpp holds on for ever in a registration, and this lock with it. So it is always
/// waited for with a deadline.
class WiringLock
{
public:
  /// How long a node waits for the lock, which then goes on as it would without us.
  static constexpr std::chrono::milliseconds PATIENCE{2000};

  /// Goes on without the lock, and says so, if another thread holds it for that long.
  ///
  /// @param patience 0: for calls under locks that the holder may wait for
  explicit WiringLock(std::chrono::milliseconds patience = PATIENCE);

  /// Raises Refusal if another thread holds it until the deadline.
  explicit WiringLock(Clock::time_point deadline);

private:
  std::unique_lock<std::recursive_timed_mutex> lock_;
};

/// roscpp starts, for the first time or again.
void noteStart();

/// roscpp is about to shut down and to withdraw all registrations: nothing is registered from now on, or it
/// would be left at the master.
void noteShutdown();

/// Whether roscpp may be called: when it is shut down, it may be destroyed any moment.
bool isUp();

/// How often roscpp was shut down. Topics registered before a shutdown have no registration any more, and its
/// callback queue may be gone.
std::uint32_t shutdowns();

/// roscpp publishes statistics of messages, from under its own locks.
void noteStatistics();

bool subscribe(const WiringLock&, const ros::SubscribeOptions& options);

void unsubscribe(const WiringLock&, const std::string& topic,
                 const ros::SubscriptionCallbackHelperPtr& helper);

/// @param known set to the addresses of other nodes that the master knows as subscribers; none if this process is on
/// the topic already
bool advertise(const WiringLock&, const ros::AdvertiseOptions& options,
               const ros::SubscriberCallbacksPtr& callbacks, std::set<std::string>* known = nullptr);

/// The master's answers: the one to `advertise` of this thread has the subscribers.
void noteAnswer(const std::string& question, XmlRpc::XmlRpcValue& answer);

/// Whether a publisher of this process is on a topic.
bool isAdvertised(const WiringLock&, const std::string& topic);

void unadvertise(const WiringLock&, const std::string& topic, const ros::SubscriberCallbacksPtr& callbacks);

/// Address of the hook of TopicManager::unregisterPublisher, which is private.
void* unregisterPublisherHook();

/// Puts off what `unadvertise` of this thread has to pass to the master; false if it is not in there.
bool putOffUnregistration(const std::string& topic);

/// What roscpp has for a topic that a publisher of this process is on; null if none is.
ros::PublicationPtr publication(const std::string& topic);

void publish(const std::string& topic, const boost::function<ros::SerializedMessage()>& serialise,
             ros::SerializedMessage& message);

/// Same, without roscpp's search: it compares the name with those of all topics of the process.
void publish(ros::Publication& publication, const boost::function<ros::SerializedMessage()>& serialise,
             ros::SerializedMessage& message);

/// Sends a serialised message to some of a publication's subscribers.
void send(const std::vector<ros::SubscriberLinkPtr>& links, const ros::SerializedMessage& message);

/// Passes the messages of a publication on that wait for roscpp's thread.
void flush(ros::Publication& publication);

std::size_t subscribers(const std::string& topic);
std::size_t publishers(const std::string& topic);
void incrementSequence(const std::string& topic);

}  // namespace dyknow::topics

#endif
