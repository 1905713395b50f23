// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "port_publication.h"

#include <ros/callback_queue_interface.h>

#include <algorithm>
#include <set>

#include "later.h"
#include "leases.h"
#include "problems.h"

namespace dyknow
{
namespace
{

/// How long an old registration stays with subscribers outside: published messages reach the network first.
constexpr std::chrono::milliseconds LINGER(200);

/// Topics to which publications are about to move.
class Destinations
{
public:
  static Destinations& instance()
  {
    static Destinations& destinations = *new Destinations;  // leaked, see later.cpp
    return destinations;
  }

  /// A topic is one of them for as long as the result lives.
  std::shared_ptr<void> add(const std::string& topic)
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    const auto place = topics_.insert(topic);
    return std::shared_ptr<void>(nullptr,
                                 [this, place](void*)
                                 {
                                   std::lock_guard<std::mutex> lock(state_lock_);
                                   topics_.erase(place);
                                 });
  }

  bool has(const std::string& topic) const
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    return topics_.count(topic) > 0;
  }

private:
  mutable std::mutex state_lock_;
  std::multiset<std::string> topics_;
};

}  // namespace

PortPublication::PortPublication(std::shared_ptr<Port> port) : port_(std::move(port)) {}

bool PortPublication::open(const ros::AdvertiseOptions& options, const ros::SubscriberCallbacksPtr& callbacks)
{
  const Traffic before = port_->join(shared_from_this(), options.datatype);
  port_->is_watched = port_->is_watched || options.connect_cb;
  RegistrationPtr first;
  {
    std::lock_guard<std::mutex> lock(message_lock_);
    traffic_ = before;
    is_latched_ = options.latch;
    options_ = options;
    options_.tracked_object.reset();  // the node's callbacks hold it weakly
    node_ = callbacks;
    shutdowns_ = topics::shutdowns();
    is_open_ = true;
    const std::string topic = port_->topic();
    if (topic.empty())
    {
      return true;
    }
    first = active_ = std::make_shared<Registration>(topic, node_, port_->owner);
  }
  const topics::WiringLock lock;
  try
  {
    if (isActive(first))
    {
      first->advertise(lock, options_);
    }
  }
  catch (const Refusal&)
  {
    if (topics::isUp())
    {
      throw;
    }
    // roscpp shuts down. A node publishes at once, and roscpp aborts if its handle was refused.
    std::lock_guard<std::mutex> messages_lock(message_lock_);
    active_.reset();
  }
  return true;
}

void PortPublication::close()
{
  std::vector<RegistrationPtr> all;
  {
    std::lock_guard<std::mutex> lock(message_lock_);
    is_open_ = false;
    notice_.reset();
    all.swap(lingering_);
    for (auto* each : {&active_, &prepared_})
    {
      if (*each)
      {
        all.push_back(*each);
        each->reset();
      }
    }
  }
  port_->leave(this, traffic());
  if (!node_ || shutdowns_ != topics::shutdowns())
  {
    return;
  }
  {
    // Lingering ones too, at once: push_latched_message_ has a raw pointer to the node's publisher.
    const topics::WiringLock lock;
    for (const auto& each : all)
    {
      each->unadvertise(lock);
    }
  }
  if (node_->callback_queue_ != nullptr)
  {
    node_->callback_queue_->removeByID(reinterpret_cast<std::uint64_t>(node_.get()));
  }
}

void PortPublication::publish(const boost::function<ros::SerializedMessage()>& serialise,
                              ros::SerializedMessage& message)
{
  std::lock_guard<std::mutex> lock(message_lock_);
  if (active_ && !Leases::instance().mayPublish(port_->owner, active_->topic))
  {
    traffic_.dropped();
    message = passed_;  // ros::Publisher keeps it, if it is latched, in place of the one before
    return;
  }
  if (active_)
  {
    traffic_.count(Clock::now());
    active_->publish(serialise, message);
  }
  else
  {
    traffic_.dropped();
    if (is_latched_)
    {
      message = serialise();  // ros::Publisher keeps it for those to come
    }
  }
  if (is_latched_)
  {
    port_->latched = true;
    passed_ = message;
    if (prepared_ && message.buf && (!active_ || active_->topic != prepared_->topic) &&
        Leases::instance().mayPublish(port_->owner, prepared_->topic))
    {
      prepared_->send(message);  // roscpp has pushed what was latched when they connected
    }
  }
}

void PortPublication::incrementSequence()
{
  std::lock_guard<std::mutex> lock(message_lock_);
  if (active_)
  {
    active_->incrementSequence();
  }
}

std::size_t PortPublication::subscribers() const
{
  std::string now;
  std::string next;
  {
    std::lock_guard<std::mutex> lock(message_lock_);
    now = active_ ? active_->topic : "";
    next = prepared_ ? prepared_->topic : "";
  }
  return (now.empty() ? 0 : topics::subscribers(now)) +
         (next.empty() || next == now ? 0 : topics::subscribers(next));
}

void PortPublication::prepare(const std::string& topic, Clock::time_point deadline, const OutTopics&)
{
  RegistrationPtr registration;
  {
    std::lock_guard<std::mutex> lock(message_lock_);
    if (!is_open_)
    {
      return;
    }
    is_prepared_ = true;
    if (topic.empty())
    {
      return;
    }
    registration = prepared_ = std::make_shared<Registration>(topic, node_, port_->owner);
    notice_ = Destinations::instance().add(topic);
  }
  const topics::WiringLock lock(deadline);
  if (isOpen())  // otherwise close() has had the lock before us
  {
    registration->advertise(lock, options_);
  }
}

bool PortPublication::isReady() const
{
  RegistrationPtr next;
  {
    std::lock_guard<std::mutex> lock(message_lock_);
    next = prepared_;
  }
  return !next || next->isHeardByAll();
}

bool PortPublication::commit(const AnnouncementPtr&)
{
  RegistrationPtr old;
  std::lock_guard<std::mutex> lock(message_lock_);
  if (is_open_ && is_prepared_)
  {
    is_prepared_ = false;
    notice_.reset();
    old.swap(active_);
    active_.swap(prepared_);
    if (old)
    {
      withdrawLater(old);
    }
  }
  return false;  // the node's messages go to the new topic already
}

void PortPublication::cancel()
{
  RegistrationPtr cancelled;
  std::lock_guard<std::mutex> lock(message_lock_);
  is_prepared_ = false;
  notice_.reset();
  cancelled.swap(prepared_);
  if (cancelled)
  {
    withdrawLater(cancelled);
  }
}

bool PortPublication::isAnyMovingTo(const std::string& topic)
{
  return Destinations::instance().has(topic);
}

std::string PortPublication::topic() const
{
  std::lock_guard<std::mutex> lock(message_lock_);
  return active_ ? active_->topic : "";
}

bool PortPublication::isOpen() const
{
  std::lock_guard<std::mutex> lock(message_lock_);
  return is_open_;
}

Traffic PortPublication::traffic() const
{
  std::lock_guard<std::mutex> lock(message_lock_);
  return traffic_;
}

bool PortPublication::isActive(const RegistrationPtr& registration) const
{
  std::lock_guard<std::mutex> lock(message_lock_);
  return active_ == registration;
}

void PortPublication::withdrawLater(const RegistrationPtr& old)
{
  lingering_.push_back(old);
  old->flush();  // roscpp drops what its thread has not passed on, and it must come before the next messages
  const auto due = Clock::now() + (old->isHeardOutside() ? LINGER : LINGER * 0);
  old->disconnectAll();
  later(
      [self = shared_from_this(), old]
      {
        const topics::WiringLock lock;
        {
          std::lock_guard<std::mutex> message_lock(self->message_lock_);
          auto& lingering = self->lingering_;
          lingering.erase(std::remove(lingering.begin(), lingering.end(), old), lingering.end());
        }
        old->unadvertise(lock);
      },
      due);
}

}  // namespace dyknow
