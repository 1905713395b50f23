// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "port_subscription.h"

#include <ros/this_node.h>

#include <algorithm>
#include <utility>

#include "later.h"
#include "port_publication.h"
#include "problems.h"

namespace dyknow
{
namespace
{

/// How long the old topic stays live while the new one, which has a publisher, is silent.
constexpr std::chrono::milliseconds CONNECTED_PATIENCE(100);
/// Same, while the new one has no publisher.
constexpr std::chrono::milliseconds UNPUBLISHED_PATIENCE(500);
/// How often it is looked whether a publisher has come.
constexpr std::chrono::milliseconds LOOK_STEP(5);

/// The oldest message of a connection.
std::list<QueuedMessage>::iterator firstOf(std::list<QueuedMessage>& messages, const Connection& connection)
{
  return std::find_if(messages.begin(), messages.end(),
                      [&connection](const auto& each) { return each.connection.get() == &connection; });
}

}  // namespace

PortSubscription::PortSubscription(std::shared_ptr<Port> port) : port_(std::move(port)) {}

bool PortSubscription::open(const ros::SubscribeOptions& options)
{
  const Traffic before = port_->join(shared_from_this(), options.datatype);
  ConnectionPtr first;
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    traffic_ = before;
    options_ = options;
    options_.tracked_object.reset();
    is_tracked_ = static_cast<bool>(options.tracked_object);
    tracked_ = options.tracked_object;
    shutdowns_ = topics::shutdowns();
    is_open_ = true;
    const std::string topic = port_->topic();
    if (topic.empty())
    {
      return true;
    }
    first = active_ = makeConnectionLocked(topic, Connection::State::OPEN);
  }
  const topics::WiringLock lock;
  return !isActive(first) || registerConnection(lock, first);
}

void PortSubscription::close()
{
  std::vector<ConnectionPtr> all;
  std::list<QueuedMessage> left;  // destroyed without the lock
  AnnouncementPtr announcement;
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    is_open_ = false;
    announcement.swap(announcement_);
    for (auto* each : {&active_, &waiting_, &prepared_})
    {
      if (*each)
      {
        (*each)->state_ = Connection::State::CLOSED;
        left.splice(left.end(), (*each)->held_);
        all.push_back(std::move(*each));
      }
    }
    left.splice(left.end(), queue_);
  }
  port_->leave(this, traffic());
  if (shutdowns_ != topics::shutdowns())
  {
    return;
  }
  if (announcement)
  {
    announcement->make();  // the old topic is left
  }
  {
    const std::lock_guard<std::mutex> none_is_queued(queueing_lock_);  // from now on
  }
  {
    const topics::WiringLock lock;
    for (const auto& each : all)
    {
      topics::unsubscribe(lock, each->topic, each);
    }
  }
  if (options_.callback_queue == nullptr)
  {
    return;  // it was never open
  }
  options_.callback_queue->removeByID(callbackId());
  if (options_.allow_concurrent_callbacks)
  {
    return;  // roscpp waits for none of them either
  }
  std::unique_lock<std::mutex> lock(state_lock_);
  callback_ended_.wait(lock, [this] { return !isRunningElsewhereLocked(); });
}

bool PortSubscription::take(QueuedMessage&& message)
{
  Connection& connection = *message.connection;
  const ros::CallbackInterfacePtr callback = message.connection;
  std::list<QueuedMessage> lost;  // destroyed without the lock
  const std::lock_guard<std::mutex> queueing(queueing_lock_);
  {
    const std::lock_guard<std::mutex> lock(state_lock_);
    if (connection.meets_own_ && isOwn(message))
    {
      return false;
    }
    if (waiting_ && (connection.state_ == Connection::State::WAITING || (announcement_ && announcement_->isMade())))
    {
      switchLocked(waiting_);  // or another in-port of the change has, which the node was told
    }
    if (connection.state_ == Connection::State::CLOSED)
    {
      return true;
    }
    if (connection.last_.lock() == message.deserializer)
    {
      return false;  // see switchLocked
    }
    connection.last_ = message.deserializer;
    const bool is_held = connection.state_ == Connection::State::HELD;
    auto& messages = is_held ? connection.held_ : queue_;
    messages.push_back(std::move(message));
    if (connection.queue_size_ > 0 && connection.queued_ == connection.queue_size_)
    {
      const auto oldest = firstOf(messages, connection);
      lost.splice(lost.end(), messages, oldest);
      traffic_.dropped();
      return true;
    }
    ++connection.queued_;
    if (is_held)
    {
      return false;
    }
  }
  connection.queue_->addCallback(callback, callbackId());
  return false;
}

ros::CallbackInterface::CallResult PortSubscription::deliver(const Connection& latest)
{
  std::list<QueuedMessage> taken;
  ros::VoidConstPtr tracked;
  const auto start = Clock::now();
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    if (queue_.empty() || queue_.front().connection->number_ > latest.number_)
    {
      return ros::CallbackInterface::Invalid;
    }
    if (isRunningElsewhereLocked() && !options_.allow_concurrent_callbacks)
    {
      return ros::CallbackInterface::TryAgain;
    }
    if (is_tracked_ && !(tracked = tracked_.lock()))
    {
      return ros::CallbackInterface::Invalid;
    }
    taken.splice(taken.end(), queue_, queue_.begin());
    --taken.front().connection->queued_;
    if (taken.front().connection.get() != &latest && latest.queued_ > 0)
    {
      // Another thread has put the callback of this message behind this one, which a later message needs: the
      // other one will not deliver that, and take() adds none while the queue is full.
      queueCallbacks(firstOf(queue_, latest)->connection, 1);
    }
    running_.push_back(std::this_thread::get_id());
    traffic_.count(start);
  }
  struct Running
  {
    ~Running()
    {
      const auto took = Clock::now() - start;
      std::lock_guard<std::mutex> lock(self.state_lock_);
      self.traffic_.processed(took);
      auto& running = self.running_;
      running.erase(std::find(running.begin(), running.end(), std::this_thread::get_id()));
      if (!self.is_open_)
      {
        self.callback_ended_.notify_all();
      }
    }
    PortSubscription& self;
    const Clock::time_point start;
  } running{*this, start};
  const auto& message = taken.front();
  if (const ros::VoidConstPtr content = message.deserializer->deserialize())  // else roscpp has logged why
  {
    ros::SubscriptionCallbackHelperCallParams params{
        {content, message.deserializer->getConnectionHeader(), message.receipt_time,
         message.has_other_receivers, ros::MessageEvent<void const>::CreateFunction()}};
    message.connection->original_->call(params);
  }
  return ros::CallbackInterface::Success;
}

std::size_t PortSubscription::publishers() const
{
  const std::string now = topic();
  return now.empty() ? 0 : topics::publishers(now);
}

void PortSubscription::prepare(const std::string& topic, Clock::time_point deadline, const OutTopics& outs)
{
  ConnectionPtr connection;
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    if (!is_open_)
    {
      return;
    }
    is_prepared_ = true;
    stays_ = active_ && active_->topic == topic && !waiting_;
    if (stays_)
    {
      return;
    }
    for (const auto& old : {active_, waiting_})
    {
      if (old)
      {
        old->meets_own_ = outs.come.count(old->topic) > 0;
      }
    }
    if (topic.empty())
    {
      return;
    }
    connection = prepared_ = makeConnectionLocked(topic, Connection::State::HELD);
    connection->meets_own_ = outs.left.count(topic) > 0;
  }
  const topics::WiringLock lock(deadline);
  if (!isOpen())
  {
    return;  // closed in between: close() has the lock after us, or had it before
  }
  if (!registerConnection(lock, connection))
  {
    throw Refusal("cannot subscribe to '" + topic + "'");
  }
}

void PortSubscription::makeWay()
{
  std::vector<std::string> met;
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    for (const auto& old : {active_, waiting_})
    {
      if (old && old->meets_own_)
      {
        met.push_back(old->topic);
      }
    }
  }
  for (const auto& topic : met)
  {
    if (const auto publication = topics::publication(topic))
    {
      topics::flush(*publication);  // what roscpp's thread has not passed on is from before the change
    }
  }
  std::lock_guard<std::mutex> lock(state_lock_);
  if (waiting_ && !met.empty())
  {
    switchLocked(waiting_);
  }
  if (active_ && active_->meets_own_)
  {
    active_->state_ = Connection::State::CLOSED;
  }
}

bool PortSubscription::commit(const AnnouncementPtr& announcement)
{
  ConnectionPtr next;
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    if (!is_open_ || !is_prepared_)
    {
      return false;
    }
    is_prepared_ = false;
    if (std::exchange(stays_, false))
    {
      return false;
    }
    if (waiting_)
    {
      switchLocked(waiting_);  // an earlier move whose topic is still silent: now it is the old one
    }
    next.swap(prepared_);
    announcement_ = announcement;
    if (next)
    {
      next->meets_own_ = false;
    }
    if (!next || next->queued_ > 0 || !active_ || active_->state_ == Connection::State::CLOSED)
    {
      switchLocked(next);
      return true;
    }
    next->state_ = Connection::State::WAITING;
    waiting_ = next;
  }
  const auto now = Clock::now();
  later([self = shared_from_this(), next, now] { self->switchIfDue(next, now); }, now + LOOK_STEP);
  return true;
}

void PortSubscription::cancel()
{
  ConnectionPtr cancelled;
  std::list<QueuedMessage> held;  // destroyed without the lock
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    is_prepared_ = stays_ = false;
    for (const auto& old : {active_, waiting_})
    {
      if (old)
      {
        old->meets_own_ = false;
      }
    }
    cancelled.swap(prepared_);
    if (!cancelled)
    {
      return;
    }
    cancelled->state_ = Connection::State::CLOSED;
    held.swap(cancelled->held_);
  }
  const topics::WiringLock lock;
  topics::unsubscribe(lock, cancelled->topic, cancelled);
}

std::string PortSubscription::topic() const
{
  std::lock_guard<std::mutex> lock(state_lock_);
  return waiting_ ? waiting_->topic : active_ ? active_->topic : "";
}

bool PortSubscription::isOpen() const
{
  std::lock_guard<std::mutex> lock(state_lock_);
  return is_open_;
}

Traffic PortSubscription::traffic() const
{
  std::lock_guard<std::mutex> lock(state_lock_);
  return traffic_;
}

bool PortSubscription::isOwn(const QueuedMessage& message) const
{
  const std::string* latched_by = Registration::latchedBy();
  if (latched_by != nullptr || message.connection->state_ != Connection::State::HELD)
  {
    return latched_by != nullptr && *latched_by == port_->owner;
  }
  // roscpp does not say which publisher of this process it is of: those of the others are not due yet, either.
  const auto header = message.deserializer->getConnectionHeader();
  const auto sender = header->find("callerid");
  return sender != header->end() && sender->second == ros::this_node::getName();
}

bool PortSubscription::isActive(const ConnectionPtr& connection) const
{
  std::lock_guard<std::mutex> lock(state_lock_);
  return active_ == connection;
}

ConnectionPtr PortSubscription::makeConnectionLocked(const std::string& topic, Connection::State state)
{
  return boost::make_shared<Connection>(shared_from_this(), options_, topic, ++connections_, state);
}

bool PortSubscription::registerConnection(const topics::WiringLock& lock, const ConnectionPtr& connection)
{
  ros::SubscribeOptions options = options_;
  options.topic = connection->topic;
  options.helper = connection;
  options.callback_queue = connection.get();
  if (is_tracked_ && !(options.tracked_object = tracked_.lock()))
  {
    return false;
  }
  return topics::subscribe(lock, options);
}

void PortSubscription::queueCallbacks(const ConnectionPtr& connection, std::uint32_t count)
{
  for (; count > 0; --count)
  {
    connection->queue_->addCallback(connection, callbackId());
  }
}

bool PortSubscription::isRunningElsewhereLocked() const
{
  const auto here = std::this_thread::get_id();
  return std::any_of(running_.begin(), running_.end(), [here](auto each) { return each != here; });
}

void PortSubscription::switchLocked(ConnectionPtr next)
{
  if (active_)
  {
    // A queue that was disabled has lost callbacks, as nodelet's loader does during onInit: without them, the
    // last messages would come after the announcement. A callback without a message does nothing.
    queueCallbacks(active_, active_->queued_);
    active_->state_ = Connection::State::CLOSED;
    if (prepared_ && prepared_->topic == active_->topic)
    {
      prepared_->held_.clear();  // a move back: both have taken these
      prepared_->queued_ = 0;
      prepared_->last_ = active_->last_;  // which roscpp may be about to give to this one too
    }
    later([old = active_] { withdraw(old); });
  }
  if (announcement_)
  {
    announcement_->make();
    announcement_.reset();
  }
  if (next)
  {
    next->state_ = Connection::State::OPEN;
    queue_.splice(queue_.end(), next->held_);
    queueCallbacks(next, next->queued_);
  }
  active_ = next;
  waiting_.reset();
}

void PortSubscription::switchIfDue(const ConnectionPtr& next, Clock::time_point committed)
{
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    if (waiting_ != next)
    {
      return;
    }
  }
  const auto now = Clock::now();
  const bool is_connected = now - committed >= CONNECTED_PATIENCE && topics::publishers(next->topic) > 0 &&
                            !PortPublication::isAnyMovingTo(next->topic);
  if (!is_connected && now - committed < UNPUBLISHED_PATIENCE)
  {
    later([self = shared_from_this(), next, committed] { self->switchIfDue(next, committed); }, now + LOOK_STEP);
    return;
  }
  std::lock_guard<std::mutex> lock(state_lock_);
  if (waiting_ == next)
  {
    switchLocked(next);
  }
}

void PortSubscription::withdraw(const ConnectionPtr& connection)
{
  const topics::WiringLock lock;
  topics::unsubscribe(lock, connection->topic, connection);
}

}  // namespace dyknow
