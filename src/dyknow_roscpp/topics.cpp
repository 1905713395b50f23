// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "topics.h"

#include <ros/console.h>
#include <ros/names.h>
#include <ros/poll_manager.h>
#include <ros/publication.h>
#include <ros/subscriber_link.h>
#include <ros/topic_manager.h>
#include <ros/xmlrpc_manager.h>
#include <rosgraph_msgs/TopicStatistics.h>

#include <algorithm>
#include <atomic>
#include <vector>

#include "later.h"
#include "problems.h"
#include "symbols.h"

namespace dyknow
{

/// Names the private method, see symbols.h.
struct UnregisterPublisher
{
  using Method = bool (ros::TopicManager::*)(const std::string&);
  friend void* addressOfPrivate(UnregisterPublisher);
};

template struct PrivateMethod<UnregisterPublisher, &ros::TopicManager::unregisterPublisher>;

/// Names the private lock that roscpp publishes under.
struct PublishingLock
{
  using Member = boost::recursive_mutex ros::TopicManager::*;
  friend Member pointerTo(PublishingLock);
};

template struct PrivateMember<PublishingLock, &ros::TopicManager::advertised_topics_mutex_>;

namespace topics
{
namespace
{

std::recursive_timed_mutex& wiringMutex()
{
  static auto& mutex = *new std::recursive_timed_mutex;  // leaked, see later.cpp
  return mutex;
}

std::atomic<bool> g_is_shut_down{false};
std::atomic<std::uint32_t> g_shutdowns{0};
std::atomic<bool> g_has_statistics{false};
std::atomic<bool> g_keeps_statistics{false};

thread_local std::vector<std::string>* t_unregistered = nullptr;
thread_local std::set<std::string>* t_known = nullptr;

ros::TopicManager* manager()
{
  return ros::TopicManager::instance().get();
}

void advertiseStatistics()
{
  ros::AdvertiseOptions options;
  options.init<rosgraph_msgs::TopicStatistics>(ros::names::resolve("/statistics"), 1);
  advertise(WiringLock(), options, boost::make_shared<ros::SubscriberCallbacks>());
}

}  // namespace

WiringLock::WiringLock(std::chrono::milliseconds patience)
  : lock_(wiringMutex(), forWaiting(Clock::now() + patience))
{
  if (!lock_.owns_lock() && patience.count() > 0)
  {
    ROS_WARN_THROTTLE(10.0, "dyknow: another registration with the ROS master takes long; going on beside it");
  }
}

WiringLock::WiringLock(Clock::time_point deadline) : lock_(wiringMutex(), forWaiting(deadline))
{
  if (!lock_.owns_lock())
  {
    throw Refusal("the process is held up by another registration with the ROS master; try again");
  }
}

void noteStart()
{
  g_is_shut_down = false;
  g_keeps_statistics = false;
}

void noteShutdown()
{
  const WiringLock lock;  // a registration in progress is withdrawn by roscpp
  g_is_shut_down = true;
  ++g_shutdowns;
}

bool isUp()
{
  return !g_is_shut_down;
}

std::uint32_t shutdowns()
{
  return g_shutdowns;
}

void noteStatistics()
{
  g_has_statistics = true;
  // Else roscpp advertises them when a subscription has some, under the lock of its callbacks, and waits for that
  // of all subscriptions, whose holder may wait for the callbacks. A topic that is there needs no such lock.
  if (!g_keeps_statistics.exchange(true))
  {
    later(advertiseStatistics);
  }
}

bool subscribe(const WiringLock&, const ros::SubscribeOptions& options)
{
  static const auto next = behind(&ros::TopicManager::subscribe);
  return !g_is_shut_down && next(manager(), options);
}

void unsubscribe(const WiringLock&, const std::string& topic,
                 const ros::SubscriptionCallbackHelperPtr& helper)
{
  static const auto next = behind(&ros::TopicManager::unsubscribe);
  next(manager(), topic, helper);
}

bool advertise(const WiringLock&, const ros::AdvertiseOptions& options,
               const ros::SubscriberCallbacksPtr& callbacks, std::set<std::string>* known)
{
  static const auto next = behind(&ros::TopicManager::advertise);
  const Setting<std::set<std::string>*> asking(t_known, known);
  return !g_is_shut_down && next(manager(), options, callbacks);
}

void noteAnswer(const std::string& question, XmlRpc::XmlRpcValue& answer)
{
  if (t_known != nullptr && question == "registerPublisher" &&
      answer.getType() == XmlRpc::XmlRpcValue::TypeArray)
  {
    for (int i = 0; i < answer.size(); ++i)
    {
      t_known->insert(answer[i]);
    }
    t_known->erase(ros::XMLRPCManager::instance()->getServerURI());
  }
}

bool isAdvertised(const WiringLock&, const std::string& topic)
{
  const ros::PublicationPtr found = manager()->lookupPublication(topic);
  return found && found->getNumCallbacks() > 0;
}

ros::PublicationPtr publication(const std::string& topic)
{
  return manager()->lookupPublication(topic);
}

void unadvertise(const WiringLock&, const std::string& topic, const ros::SubscriberCallbacksPtr& callbacks)
{
  static const auto next = behind(&ros::TopicManager::unadvertise);
  using Unregister = bool (*)(ros::TopicManager*, const std::string&);
  static const auto unregister = reinterpret_cast<Unregister>(requireBehind(unregisterPublisherHook()));
  // roscpp asks the master while it holds the lock that every publish needs: it is queried after that.
  std::vector<std::string> unregistered;
  {
    const Setting<std::vector<std::string>*> noting(t_unregistered, &unregistered);
    next(manager(), topic, callbacks);
  }
  for (const auto& each : unregistered)
  {
    unregister(manager(), each);
  }
}

void* unregisterPublisherHook()
{
  return addressOfPrivate(UnregisterPublisher());
}

bool putOffUnregistration(const std::string& topic)
{
  if (t_unregistered == nullptr)
  {
    return false;
  }
  t_unregistered->push_back(topic);
  return true;
}

void publish(const std::string& topic, const boost::function<ros::SerializedMessage()>& serialise,
             ros::SerializedMessage& message)
{
  using Publish = void (ros::TopicManager::*)(
      const std::string&, const boost::function<ros::SerializedMessage(void)>&, ros::SerializedMessage&);
  static const auto next = behind(static_cast<Publish>(&ros::TopicManager::publish));
  next(manager(), topic, serialise, message);
}

void publish(ros::Publication& publication, const boost::function<ros::SerializedMessage()>& serialise,
             ros::SerializedMessage& message)
{
  if (publication.isDropped())
  {
    return;  // by a shutdown of roscpp
  }
  // roscpp takes this lock before those of the publication and its subscribers. Where it publishes statistics,
  // it takes it under these as well.
  boost::unique_lock<boost::recursive_mutex> lock(manager()->*pointerTo(PublishingLock()), boost::defer_lock);
  if (g_has_statistics)
  {
    lock.lock();
  }
  if (!publication.hasSubscribers() && !publication.isLatching())
  {
    publication.incrementSequence();
    return;
  }
  // Subscribers of this process that take the same type get the pointer, all other receivers bytes.
  bool is_shared = false;
  bool is_serialised = message.type_info == nullptr || !message.message;
  if (!is_serialised)
  {
    publication.getPublishTypes(is_serialised, is_shared, *message.type_info);
  }
  if (!is_shared)
  {
    message.message.reset();
    message.type_info = nullptr;
  }
  if (is_serialised || publication.isLatching())
  {
    const ros::SerializedMessage serialised = serialise();
    message.buf = serialised.buf;
    message.num_bytes = serialised.num_bytes;
    message.message_start = serialised.message_start;
  }
  publication.publish(message);
  if (is_serialised)
  {
    ros::PollManager::instance()->getPollSet().signal();  // roscpp's thread sends the queued messages
  }
}

void send(const std::vector<ros::SubscriberLinkPtr>& links, const ros::SerializedMessage& message)
{
  // Bytes of their own: roscpp's thread writes the sequence number into those that it publishes.
  const boost::shared_array<std::uint8_t> bytes(new std::uint8_t[message.num_bytes]);
  std::copy_n(message.buf.get(), message.num_bytes, bytes.get());
  ros::SerializedMessage copy(bytes, message.num_bytes);
  copy.message_start = bytes.get() + (message.message_start - message.buf.get());
  // As roscpp's thread holds it: a subscriber may publish statistics.
  const boost::unique_lock<boost::recursive_mutex> lock(manager()->*pointerTo(PublishingLock()));
  for (const auto& link : links)
  {
    link->enqueueMessage(copy, true, true);
  }
}

void flush(ros::Publication& publication)
{
  const boost::unique_lock<boost::recursive_mutex> lock(manager()->*pointerTo(PublishingLock()));
  publication.processPublishQueue();
}

std::size_t subscribers(const std::string& topic)
{
  static const auto next = behind(&ros::TopicManager::getNumSubscribers);
  return next(manager(), topic);
}

std::size_t publishers(const std::string& topic)
{
  static const auto next = behind(&ros::TopicManager::getNumPublishers);
  return next(manager(), topic);
}

void incrementSequence(const std::string& topic)
{
  static const auto next = behind(&ros::TopicManager::incrementSequence);
  next(manager(), topic);
}

}  // namespace topics
}  // namespace dyknow
