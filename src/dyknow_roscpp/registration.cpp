// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include <ros/callback_queue_interface.h>
#include <ros/publication.h>
#include <ros/single_subscriber_publisher.h>

#include <algorithm>
#include <iterator>
#include <map>

#include "leases.h"
#include "master.h"
#include "port_publication.h"
#include "problems.h"
#include "symbols.h"

namespace dyknow
{

/// Names the private link of a peer, see symbols.h.
struct LinkOf
{
  using Member = ros::SubscriberLinkPtr ros::SingleSubscriberPublisher::*;
  friend Member pointerTo(LinkOf);
};

template struct PrivateMember<LinkOf, &ros::SingleSubscriberPublisher::link_>;

namespace
{

/// How long the master may take to look up the address of a node.
constexpr std::chrono::milliseconds ADDRESS_PATIENCE(100);

/// Calls at once. roscpp waits for callbacks in a queue when it removes them, and it does so under the wiring
/// lock: it must not wait for the node's code. The callback only passes the call on to the node's
/// queue.
class DirectQueue : public ros::CallbackQueueInterface
{
public:
  void addCallback(const ros::CallbackInterfacePtr& callback, std::uint64_t) override { callback->call(); }
  void removeByID(std::uint64_t) override {}
};

/// A callback of the node about one subscriber.
class StatusCall : public ros::CallbackInterface
{
public:
  StatusCall(ros::SubscriberStatusCallback callback, ros::SubscriberLinkPtr link,
             const ros::SubscriberCallbacks& node)
    : callback_(std::move(callback))
    , link_(std::move(link))
    , is_tracked_(node.has_tracked_object_)
    , tracked_(node.tracked_object_)
  {
  }

  CallResult call() override
  {
    ros::VoidConstPtr kept;
    if (is_tracked_ && !(kept = tracked_.lock()))
    {
      return Invalid;
    }
    callback_(ros::SingleSubscriberPublisher(link_));
    return Success;
  }

private:
  const ros::SubscriberStatusCallback callback_;
  const ros::SubscriberLinkPtr link_;
  const bool is_tracked_;
  const ros::VoidConstWPtr tracked_;
};

/// Whether this thread joins a publication that is there, whose links then have not been sent a latched
/// message.
thread_local bool t_joining = false;

thread_local const std::string* t_latched_by = nullptr;

/// The address of a node; empty if the master knows none.
std::string addressOfNode(const std::string& node)
{
  try
  {
    XmlRpc::XmlRpcValue found = askMaster("lookupNode", node, Clock::now() + ADDRESS_PATIENCE);
    return found.valid() ? static_cast<std::string>(found) : "";
  }
  catch (const Refusal&)
  {
    return "";
  }
}

/// The subscribers of a topic, which the publications there share; `is_new`: there is no other one.
std::shared_ptr<Audience> audienceOf(const topics::WiringLock&, const std::string& topic, bool is_new)
{
  static auto& state_lock = *new std::mutex;  // leaked, see later.cpp
  static auto& audiences = *new std::map<std::string, std::weak_ptr<Audience>>;
  std::lock_guard<std::mutex> lock(state_lock);
  auto found = audiences[topic].lock();
  if (!found || is_new)
  {
    found = std::make_shared<Audience>();
    audiences[topic] = found;
  }
  for (auto each = audiences.begin(); each != audiences.end();)
  {
    each = each->second.expired() ? audiences.erase(each) : std::next(each);
  }
  return found;
}

ros::SubscriberCallbacksPtr makeCallbacks()
{
  static auto& queue = *new DirectQueue;  // leaked, see later.cpp
  auto callbacks = boost::make_shared<ros::SubscriberCallbacks>();
  callbacks->callback_queue_ = &queue;
  return callbacks;
}

}  // namespace

void Audience::expect(std::set<std::string> addresses)
{
  std::lock_guard<std::mutex> lock(state_lock_);
  awaited_ = std::move(addresses);
  is_awaiting_ = !awaited_.empty();
}

void Audience::connected(const std::string& node)
{
  std::lock_guard<std::mutex> lock(state_lock_);
  if (is_awaiting_)
  {
    named_.push_back(node);
  }
}

bool Audience::isComplete()
{
  std::vector<std::string> named;
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    named.swap(named_);
  }
  std::set<std::string> addresses;
  for (const auto& node : named)
  {
    addresses.insert(addressOfNode(node));
  }
  std::lock_guard<std::mutex> lock(state_lock_);
  for (const auto& address : addresses)
  {
    awaited_.erase(address);
  }
  is_awaiting_ = !awaited_.empty();
  return !is_awaiting_;
}

Registration::Registration(std::string topic, ros::SubscriberCallbacksPtr node, const std::string& owner)
  : topic(std::move(topic))
  , callbacks(makeCallbacks())
  , node_(std::move(node))
  , owner_(owner)
{
}

void Registration::advertise(const topics::WiringLock& lock, ros::AdvertiseOptions options)
{
  options.topic = topic;
  callbacks->connect_ = [self = weak_from_this()](const ros::SingleSubscriberPublisher& peer)
  {
    if (const auto here = self.lock())
    {
      here->connected(peer.*pointerTo(LinkOf()));
    }
  };
  callbacks->disconnect_ = [self = weak_from_this()](const ros::SingleSubscriberPublisher& peer)
  {
    if (const auto here = self.lock())
    {
      here->disconnected(peer.*pointerTo(LinkOf()));
    }
  };
  if (node_->push_latched_message_)
  {
    callbacks->push_latched_message_ = [self = weak_from_this()](const auto& link)
    {
      if (const auto here = self.lock())
      {
        here->pushLatched(link);
      }
    };
  }
  const bool is_joining = topics::isAdvertised(lock, topic);
  audience_ = audienceOf(lock, topic, !is_joining);
  const Setting<bool> joining(t_joining, is_joining);
  std::set<std::string> known;
  is_advertised_ = topics::advertise(lock, options, callbacks, &known);
  if (!is_joining)
  {
    audience_->expect(std::move(known));
  }
  const auto publication = topics::publication(topic);
  {
    std::lock_guard<std::mutex> links_lock(links_lock_);
    publication_ = publication;
  }
  if (!is_advertised_ || !publication)  // there is none any more when ROS shuts down
  {
    throw Refusal("cannot advertise '" + topic + "'");
  }
}

void Registration::unadvertise(const topics::WiringLock& lock)
{
  if (is_advertised_)
  {
    is_advertised_ = false;
    topics::unadvertise(lock, topic, callbacks);
  }
}

void Registration::publish(const boost::function<ros::SerializedMessage()>& serialise,
                           ros::SerializedMessage& message)
{
  topics::publish(*publication_, serialise, message);
}

void Registration::incrementSequence()
{
  publication_->incrementSequence();
}

void Registration::send(const ros::SerializedMessage& message) const
{
  std::vector<ros::SubscriberLinkPtr> links;
  {
    std::lock_guard<std::mutex> lock(links_lock_);
    links = links_;
  }
  const Setting<const std::string*> sending(t_latched_by, &owner_);
  topics::send(links, message);
}

const std::string* Registration::latchedBy()
{
  return t_latched_by;
}

void Registration::flush() const
{
  ros::PublicationPtr publication;
  {
    std::lock_guard<std::mutex> lock(links_lock_);
    publication = publication_;
  }
  if (publication)
  {
    topics::flush(*publication);
  }
}

void Registration::disconnectAll()
{
  std::vector<ros::SubscriberLinkPtr> left;
  {
    std::lock_guard<std::mutex> lock(links_lock_);
    is_withdrawn_ = true;
    left.swap(links_);
  }
  for (const auto& link : left)
  {
    queueForNode(node_->disconnect_, link);
  }
}

bool Registration::isHeardByAll() const
{
  return !audience_ || audience_->isComplete();
}

bool Registration::isHeardOutside() const
{
  std::lock_guard<std::mutex> lock(links_lock_);
  return std::any_of(links_.begin(), links_.end(), [](const auto& link) { return !link->isIntraprocess(); });
}

void Registration::pushLatched(const ros::SubscriberLinkPtr& link) const
{
  {
    std::lock_guard<std::mutex> lock(links_lock_);
    if (is_withdrawn_)
    {
      return;  // the port has moved away
    }
  }
  if (Leases::instance().mayPublish(owner_, topic))
  {
    const Setting<const std::string*> sending(t_latched_by, &owner_);
    node_->push_latched_message_(link);
  }
}

void Registration::connected(const ros::SubscriberLinkPtr& link)
{
  if (!link->isIntraprocess())
  {
    audience_->connected(link->getDestinationCallerID());
  }
  {
    std::lock_guard<std::mutex> lock(links_lock_);
    if (is_withdrawn_)
    {
      return;  // the node would not hear of its end
    }
    links_.push_back(link);
  }
  if (t_joining && callbacks->push_latched_message_)
  {
    callbacks->push_latched_message_(link);
  }
  queueForNode(node_->connect_, link);
}

void Registration::disconnected(const ros::SubscriberLinkPtr& link)
{
  {
    std::lock_guard<std::mutex> lock(links_lock_);
    const auto found = std::find(links_.begin(), links_.end(), link);
    if (found == links_.end())
    {
      return;  // the node was notified when the port moved away
    }
    links_.erase(found);
  }
  queueForNode(node_->disconnect_, link);
}

void Registration::queueForNode(const ros::SubscriberStatusCallback& callback,
                                const ros::SubscriberLinkPtr& link) const
{
  if (callback && node_->callback_queue_ != nullptr)
  {
    const auto call = boost::make_shared<StatusCall>(callback, link, *node_);
    node_->callback_queue_->addCallback(call, reinterpret_cast<std::uint64_t>(node_.get()));
  }
}

}  // namespace dyknow
