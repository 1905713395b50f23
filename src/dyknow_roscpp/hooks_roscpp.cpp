// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The hooks: definitions of libroscpp's functions that come before its own.
#include <ros/init.h>
#include <ros/master.h>
#include <ros/node_handle.h>
#include <ros/poll_set.h>
#include <ros/statistics.h>
#include <ros/subscription_queue.h>
#include <ros/this_node.h>
#include <ros/topic_manager.h>

#include <boost/align/aligned_allocator.hpp>
#include <poll.h>

#include <algorithm>
#include <cstdlib>
#include <typeinfo>

#include "later.h"
#include "port_names.h"
#include "problems.h"
#include "process_services.h"
#include "registry.h"
#include "self_check.h"
#include "symbols.h"
#include "topics.h"

namespace dyknow
{
namespace
{

using AdvertiseMethod = ros::Publisher (ros::NodeHandle::*)(ros::AdvertiseOptions&);
using SubscribeMethod = ros::Subscriber (ros::NodeHandle::*)(ros::SubscribeOptions&);
using ResolveMethod = std::string (ros::NodeHandle::*)(const std::string&, bool) const;
using ExecuteFunction = bool (*)(const std::string&, const XmlRpc::XmlRpcValue&, XmlRpc::XmlRpcValue&,
                                 XmlRpc::XmlRpcValue&, bool);
using PublishMethod = void (ros::TopicManager::*)(const std::string&,
                                                  const boost::function<ros::SerializedMessage(void)>&,
                                                  ros::SerializedMessage&);

/// What roscpp publishes of the messages that come: from under its own locks, whoever's message it is.
constexpr char STATISTICS[] = "rosgraph_msgs/TopicStatistics";

/// Whether a handle's topic is a port. Topics of the process rather than of its code are not, nor are those
/// that roscpp refuses.
template <class Options>
bool isPort(const ros::NodeHandle& handle, const Options& options)
{
  const auto& datatype = options.datatype;
  if (options.md5sum.empty() || datatype.empty() || datatype == "bond/Status" || datatype == STATISTICS)
  {
    return false;
  }
  const std::string topic = handle.resolveName(options.topic);
  return topic != "/rosout" && topic != "/clock" && !isOwnTopic(topic);
}

/// Makes the object behind a handle, and the handle with it: `make` gets the options with the key as topic.
template <class End, class Options, class Make>
auto makeHandle(const ros::NodeHandle& handle, Options& options, Direction direction, Make make)
{
  auto& registry = Registry::instance();
  const std::string resolved = handle.resolveName(options.topic);
  const auto owner = registry.ownerOf(handle, options.callback_queue);
  const auto name = namePort(*owner, handle, options.topic, direction);
  const auto port = owner->declare(name, direction, resolved);
  if (owner->name == ros::this_node::getName())
  {
    offerServices(owner);  // a nodelet's are offered when it is loaded
  }
  // Aligned as the processor's caches are, so that what every message touches is in few of their lines.
  const auto end = std::allocate_shared<End>(boost::alignment::aligned_allocator<End, 64>(), port);
  const std::string key = registry.makeKey(resolved);
  registry.add(key, end);
  struct Undo
  {
    ~Undo()
    {
      options.topic = resolved;
      if (!is_made)
      {
        registry.remove(key);
        end.close();
      }
    }
    Registry& registry;
    Options& options;
    const std::string& resolved;
    const std::string& key;
    End& end;
    bool is_made;
  } undo{registry, options, resolved, key, *end, false};
  options.topic = key;
  const std::string before = port->datatype();
  auto made = make(options);
  if (port->datatype() != before)
  {
    announceChange(owner->name);
  }
  undo.is_made = static_cast<bool>(made);
  return made;
}

/// The events of a socket, without an end that is another socket's.
///
/// roscpp learns of several events at a time. When a connection ends and another thread closes its socket before the
/// event is handled, a connection that is accepted in between has the same descriptor, and would be closed.
int ownEvents(int descriptor, int events)
{
  constexpr int END = POLLERR | POLLHUP | POLLRDHUP | POLLNVAL;
  pollfd now{descriptor, POLLRDHUP, 0};
  return (events & END) == 0 || poll(&now, 1, 0) < 0 ? events : events & (~END | now.revents);
}

/// Shuts roscpp down at the end of a process in which no handle does.
///
/// roscpp itself would do so when its objects are destroyed already, while threads use them.
void endWithProcess()
{
  if (ros::ok() && !ros::isShuttingDown())
  {
    ros::shutdown();
  }
  endLaterWork();
}

}  // namespace

std::vector<void*> roscppHooks()
{
  using Push = void (ros::SubscriptionQueue::*)(const ros::SubscriptionCallbackHelperPtr&,
                                                const ros::MessageDeserializerPtr&, bool,
                                                const ros::VoidConstWPtr&, bool, ros::Time, bool*);
  return {
      reinterpret_cast<void*>(static_cast<void (*)()>(&ros::start)),
      reinterpret_cast<void*>(static_cast<void (*)()>(&ros::shutdown)),
      reinterpret_cast<void*>(static_cast<ExecuteFunction>(&ros::master::execute)),
      addressOf(static_cast<AdvertiseMethod>(&ros::NodeHandle::advertise)),
      addressOf(static_cast<SubscribeMethod>(&ros::NodeHandle::subscribe)),
      addressOf(static_cast<ResolveMethod>(&ros::NodeHandle::resolveName)),
      addressOf(&ros::TopicManager::subscribe),
      addressOf(&ros::TopicManager::unsubscribe),
      addressOf(&ros::TopicManager::advertise),
      addressOf(&ros::TopicManager::unadvertise),
      addressOf(static_cast<PublishMethod>(&ros::TopicManager::publish)),
      addressOf(&ros::TopicManager::getNumSubscribers),
      addressOf(&ros::TopicManager::getNumPublishers),
      addressOf(&ros::TopicManager::incrementSequence),
      addressOf(&ros::TopicManager::getAdvertisedTopics),
      topics::unregisterPublisherHook(),
      addressOf(&ros::PollSet::addSocket),
      addressOf(static_cast<Push>(&ros::SubscriptionQueue::push)),
      addressOf(&ros::StatisticsLogger::init),
      addressOf(&ros::Publisher::getTopic),
      addressOf(&ros::Subscriber::getTopic),
  };
}

}  // namespace dyknow

namespace ros
{

using dyknow::Registry;

void start()
{
  static const auto next = dyknow::behind(static_cast<void (*)()>(&ros::start));
  dyknow::topics::noteStart();
  next();
  // Now: what roscpp has just made is destroyed after that.
  [[maybe_unused]] static const int failed = std::atexit(&dyknow::endWithProcess);
  // Later: this is called while the first NodeHandle is made, under the lock that the next one needs.
  dyknow::later(
      []
      {
        if (dyknow::areHooksReached())
        {
          dyknow::offerServicesAgain();
        }
      });
}

void shutdown()
{
  static const auto next = dyknow::behind(static_cast<void (*)()>(&ros::shutdown));
  dyknow::topics::noteShutdown();
  next();
}

bool master::execute(const std::string& method, const XmlRpc::XmlRpcValue& request,
                     XmlRpc::XmlRpcValue& response, XmlRpc::XmlRpcValue& payload, bool wait_for_master)
{
  static const auto next = dyknow::behind(static_cast<dyknow::ExecuteFunction>(&master::execute));
  if (method == "registerService" || method == "unregisterService")
  {
    XmlRpc::XmlRpcValue arguments = request;
    if (dyknow::isOwnService(arguments[1]))
    {
      return true;
    }
  }
  const bool is_answered = next(method, request, response, payload, wait_for_master);
  if (is_answered)
  {
    dyknow::topics::noteAnswer(method, payload);
  }
  return is_answered;
}

Publisher NodeHandle::advertise(AdvertiseOptions& ops)
{
  static const auto next = dyknow::behind(static_cast<dyknow::AdvertiseMethod>(&NodeHandle::advertise));
  if (!dyknow::areHooksReached() || !dyknow::isPort(*this, ops) || ops.datatype == "*" || ops.md5sum == "*")
  {
    return next(this, ops);
  }
  return dyknow::makeHandle<dyknow::PortPublication>(*this, ops, dyknow::Direction::OUT,
                                                     [this](auto& options) { return next(this, options); });
}

Subscriber NodeHandle::subscribe(SubscribeOptions& ops)
{
  static const auto next = dyknow::behind(static_cast<dyknow::SubscribeMethod>(&NodeHandle::subscribe));
  if (!dyknow::areHooksReached() || !dyknow::isPort(*this, ops) || !ops.helper)
  {
    return next(this, ops);
  }
  return dyknow::makeHandle<dyknow::PortSubscription>(*this, ops, dyknow::Direction::IN,
                                                      [this](auto& options) { return next(this, options); });
}

std::string NodeHandle::resolveName(const std::string& name, bool remap) const
{
  static const auto next = dyknow::behind(static_cast<dyknow::ResolveMethod>(&NodeHandle::resolveName));
  static const auto& roscpp = *new std::string(dyknow::libraryOf(reinterpret_cast<void*>(next)));
  std::string resolved = next(this, name, remap);
  // Of what roscpp resolves for itself, parameters and services, nothing is noted.
  if (remap && !name.empty() && dyknow::areHooksReached())
  {
    const std::string caller = dyknow::libraryOf(__builtin_return_address(0));
    if (caller != roscpp && caller != dyknow::libraryOf(reinterpret_cast<void*>(&dyknow::roscppHooks)))
    {
      dyknow::noteResolved(*Registry::instance().ownerOf(*this, nullptr), *this, name, resolved);
    }
  }
  return resolved;
}

bool TopicManager::subscribe(const SubscribeOptions& ops)
{
  if (const auto subscription = Registry::instance().subscription(ops.topic))
  {
    return subscription->open(ops);
  }
  const dyknow::topics::WiringLock lock;
  return dyknow::topics::subscribe(lock, ops);
}

bool TopicManager::unsubscribe(const std::string& topic, const SubscriptionCallbackHelperPtr& helper)
{
  if (const auto subscription = Registry::instance().subscription(topic))
  {
    subscription->close();
    Registry::instance().remove(topic);
    return true;
  }
  static const auto next = dyknow::behind(&TopicManager::unsubscribe);
  return next(this, topic, helper);
}

bool TopicManager::advertise(const AdvertiseOptions& ops, const SubscriberCallbacksPtr& callbacks)
{
  if (const auto publication = Registry::instance().publication(ops.topic))
  {
    try
    {
      return publication->open(ops, callbacks);
    }
    catch (const dyknow::Refusal&)  // roscpp has logged why
    {
      return false;
    }
  }
  using dyknow::topics::WiringLock;
  const WiringLock lock(ops.datatype == dyknow::STATISTICS ? WiringLock::PATIENCE * 0 : WiringLock::PATIENCE);
  return dyknow::topics::advertise(lock, ops, callbacks);
}

bool TopicManager::unadvertise(const std::string& topic, const SubscriberCallbacksPtr& callbacks)
{
  if (const auto publication = Registry::instance().publication(topic))
  {
    publication->close();
    Registry::instance().remove(topic);
    return true;
  }
  static const auto next = dyknow::behind(&TopicManager::unadvertise);
  if (callbacks && callbacks->callback_queue_ != nullptr && lookupPublication(topic))
  {
    // Waits for callbacks of the node, which must not be waited for under the lock.
    callbacks->callback_queue_->removeByID(reinterpret_cast<std::uint64_t>(callbacks.get()));
  }
  const dyknow::topics::WiringLock lock;
  return next(this, topic, callbacks);
}

bool TopicManager::unregisterPublisher(const std::string& topic)
{
  static const auto next = dyknow::behind(&TopicManager::unregisterPublisher);
  return dyknow::topics::putOffUnregistration(topic) || next(this, topic);
}

void TopicManager::publish(const std::string& topic, const boost::function<SerializedMessage(void)>& serfunc,
                           SerializedMessage& m)
{
  if (const auto publication = Registry::instance().publication(topic))
  {
    publication->publish(serfunc, m);
  }
  else if (!Registry::isKey(topic))  // a handle that is shut down meanwhile
  {
    dyknow::topics::publish(topic, serfunc, m);
  }
}

std::size_t TopicManager::getNumSubscribers(const std::string& topic)
{
  const auto publication = Registry::instance().publication(topic);
  return publication ? publication->subscribers() : dyknow::topics::subscribers(topic);
}

std::size_t TopicManager::getNumPublishers(const std::string& topic)
{
  const auto subscription = Registry::instance().subscription(topic);
  return subscription ? subscription->publishers() : dyknow::topics::publishers(topic);
}

void TopicManager::incrementSequence(const std::string& topic)
{
  if (const auto publication = Registry::instance().publication(topic))
  {
    publication->incrementSequence();
    return;
  }
  dyknow::topics::incrementSequence(topic);
}

void TopicManager::getAdvertisedTopics(V_string& names)
{
  static const auto next = dyknow::behind(&TopicManager::getAdvertisedTopics);
  if (dyknow::Probe::note())
  {
    return;
  }
  next(this, names);
  // A node sees itself as it would without us, in its messages to the log as well.
  names.erase(std::remove_if(names.begin(), names.end(), dyknow::isOwnTopic), names.end());
}

std::string Publisher::getTopic() const
{
  static const auto next = dyknow::behind(&Publisher::getTopic);
  const std::string key = next(this);
  const auto publication = Registry::instance().publication(key);
  return publication ? publication->port().topic() : Registry::topicOf(key);
}

std::string Subscriber::getTopic() const
{
  static const auto next = dyknow::behind(&Subscriber::getTopic);
  const std::string key = next(this);
  const auto subscription = Registry::instance().subscription(key);
  return subscription ? subscription->port().topic() : Registry::topicOf(key);
}

bool PollSet::addSocket(int fd, const SocketUpdateFunc& update_func, const TransportPtr& transport)
{
  static const auto next = dyknow::behind(&PollSet::addSocket);
  const auto update = [fd, update_func](int events) { update_func(dyknow::ownEvents(fd, events)); };
  return next(this, fd, update, transport);
}

void SubscriptionQueue::push(const SubscriptionCallbackHelperPtr& helper,
                             const MessageDeserializerPtr& deserializer, bool has_tracked_object,
                             const VoidConstWPtr& tracked_object, bool nonconst_need_copy,
                             ros::Time receipt_time, bool* was_full)
{
  if (helper && typeid(*helper) == typeid(dyknow::Connection))
  {
    const bool is_lost = static_cast<dyknow::Connection&>(*helper).take(
        {boost::static_pointer_cast<dyknow::Connection>(helper), deserializer, receipt_time,
         nonconst_need_copy});
    if (was_full != nullptr)
    {
      *was_full = is_lost;
    }
    return;
  }
  static const auto next = dyknow::behind(&SubscriptionQueue::push);
  next(this, helper, deserializer, has_tracked_object, tracked_object, nonconst_need_copy, receipt_time,
       was_full);
}

void StatisticsLogger::init(const SubscriptionCallbackHelperPtr& helper)
{
  static const auto next = dyknow::behind(&StatisticsLogger::init);
  next(this, helper);
  if (enable_statistics)
  {
    dyknow::topics::noteStatistics();
  }
}

}  // namespace ros
