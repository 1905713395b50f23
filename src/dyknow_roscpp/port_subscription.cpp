// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "port_subscription.h"

#include <algorithm>
#include <utility>

#include "deadline.h"
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
constexpr std::chrono::milliseconds PATIENCE(500);
/// How often it is looked whether a publisher has come.
constexpr std::chrono::milliseconds STEP(5);
/// How long a callback of the new topic waits at most for those of the old one, on other threads.
constexpr std::chrono::seconds LONGEST_DRAIN(1);

bool isIdle(std::size_t queued, const std::vector<std::thread::id>& running)
{
  const auto here = std::this_thread::get_id();
  return queued == 0 &&
         std::all_of(running.begin(), running.end(), [here](auto each) { return each == here; });
}

}  // namespace

PortSubscription::PortSubscription(std::shared_ptr<Port> port) : port_(std::move(port)) {}

bool PortSubscription::open(const ros::SubscribeOptions& options)
{
  traffic_ = port_->join(shared_from_this(), options.datatype);
  ConnectionPtr first;
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    options_ = options;
    options_.tracked_object.reset();
    is_tracked_ = static_cast<bool>(options.tracked_object);
    tracked_ = options.tracked_object;
    is_open_ = true;
    const std::string topic = port_->topic();
    if (topic.empty())
    {
      return true;
    }
    first = active_ = makeConnection(topic, Connection::State::OPEN);
  }
  const topics::WiringLock lock;
  return !isActive(first) || registerConnection(lock, first);
}

void PortSubscription::close()
{
  port_->leave(this);
  std::vector<ConnectionPtr> all;
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    is_open_ = false;
    all.assign(draining_.begin(), draining_.end());
    for (const auto& each : {active_, waiting_, prepared_})
    {
      if (each)
      {
        all.push_back(each);
      }
    }
    for (const auto& each : all)
    {
      each->state_ = Connection::State::CLOSED;
    }
    active_.reset();
    waiting_.reset();
    prepared_.reset();
    draining_.clear();
  }
  {
    const std::lock_guard<std::mutex> none_is_queued(queueing_lock_);  // from now on
  }
  {
    const topics::WiringLock lock;
    for (const auto& each : all)
    {
      // It would wait for a running callback in SubscriptionQueue::clear: we wait below, without the lock.
      topics::unsubscribeDraining(lock, each->topic, each);
    }
  }
  for (const auto& each : all)
  {
    each->queue_->removeByID(reinterpret_cast<std::uint64_t>(each.get()));
  }
  if (options_.allow_concurrent_callbacks)
  {
    return;  // roscpp waits for none of them either
  }
  std::unique_lock<std::mutex> lock(state_lock_);
  for (const auto& each : all)
  {
    callback_ended_.wait(lock, [&each] { return isIdle(0, each->running_); });
  }
}

std::size_t PortSubscription::publishers() const
{
  const std::string now = topic();
  return now.empty() ? 0 : topics::publishers(now);
}

void PortSubscription::prepare(const std::string& topic, Clock::time_point deadline)
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
    if (topic.empty() || stays_)
    {
      return;
    }
    connection = prepared_ = makeConnection(topic, Connection::State::HELD);
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

bool PortSubscription::isReady() const
{
  return true;  // the old topic is live until the new one is
}

bool PortSubscription::commit(const Announcement& announce)
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
    announce_ = announce;
    if (!next || next->queued_ > next->skipped_ || !active_)
    {
      switchLocked(next);
      return true;
    }
    next->state_ = Connection::State::WAITING;
    waiting_ = next;
  }
  const auto now = Clock::now();
  later([self = shared_from_this(), next, now] { self->switchIfDue(next, now); }, now + STEP);
  return true;
}

void PortSubscription::cancel()
{
  ConnectionPtr cancelled;
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    is_prepared_ = stays_ = false;
    cancelled.swap(prepared_);
    if (!cancelled)
    {
      return;
    }
    cancelled->state_ = Connection::State::CLOSED;
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

bool PortSubscription::isActive(const ConnectionPtr& connection) const
{
  std::lock_guard<std::mutex> lock(state_lock_);
  return active_ == connection;
}

ConnectionPtr PortSubscription::makeConnection(const std::string& topic, Connection::State state)
{
  return boost::make_shared<Connection>(weak_from_this(), options_.helper, options_.callback_queue, topic,
                                        state);
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

void PortSubscription::deliver(Connection& connection, ros::SubscriptionCallbackHelperCallParams& params)
{
  const auto here = std::this_thread::get_id();
  {
    std::unique_lock<std::mutex> lock(state_lock_);
    connection.queued_ -= connection.queued_ > 0 ? 1 : 0;
    const bool is_skipped = connection.skipped_ > 0;
    connection.skipped_ -= is_skipped ? 1 : 0;
    if (is_skipped || connection.state_ == Connection::State::CLOSED)
    {
      return;
    }
    connection.running_.push_back(here);
    awaitPredecessors(lock, connection);
  }
  struct End
  {
    ~End()
    {
      const auto now = Clock::now();
      self.traffic_->received(start, now - start);
      std::lock_guard<std::mutex> lock(self.state_lock_);
      auto& running = connection.running_;
      running.erase(std::find(running.begin(), running.end(), std::this_thread::get_id()));
      if (connection.state_ == Connection::State::DRAINING && connection.queued_ == 0 && running.empty())
      {
        auto& draining = self.draining_;
        draining.erase(std::remove_if(draining.begin(), draining.end(),
                                      [this](const auto& each) { return each.get() == &connection; }),
                       draining.end());
      }
      self.callback_ended_.notify_all();
    }
    PortSubscription& self;
    Connection& connection;
    Clock::time_point start;
  } end{*this, connection, Clock::now()};
  connection.original_->call(params);
}

void PortSubscription::awaitPredecessors(std::unique_lock<std::mutex>& lock, const Connection& connection)
{
  // Only with several threads on one callback queue can a callback of the new topic come before the last of
  // the old one. Deserialisation that fails makes the count of queued messages too high: hence the limit.
  const auto is_next = [this, &connection]
  {
    for (const auto& each : draining_)
    {
      if (each.get() == &connection)
      {
        return true;
      }
      if (!isIdle(each->queued_, each->running_))
      {
        return false;
      }
    }
    return true;
  };
  if (draining_.empty() || options_.allow_concurrent_callbacks)
  {
    return;
  }
  if (!callback_ended_.wait_until(lock, forWaiting(Clock::now() + LONGEST_DRAIN), is_next))
  {
    for (const auto& each : draining_)
    {
      each->queued_ = 0;
    }
  }
}

void PortSubscription::switchLocked(ConnectionPtr next)
{
  if (active_)
  {
    // A queue that was disabled has lost callbacks, as nodelet's loader does during onInit: without them, the
    // last messages would never be delivered. A callback without a message does nothing.
    for (std::size_t i = 0; i < active_->queued_ && active_->callback_; ++i)
    {
      active_->queueCallback();
    }
    active_->state_ = Connection::State::DRAINING;
    if (prepared_ && prepared_->topic == active_->topic)
    {
      prepared_->skipped_ = prepared_->queued_;  // a move back: both have taken these
    }
    if (!isIdle(active_->queued_, {}) || !active_->running_.empty())
    {
      draining_.push_back(active_);
    }
    later([self = shared_from_this(), old = active_] { self->withdraw(old); });
  }
  if (announce_)
  {
    std::exchange(announce_, nullptr)();
  }
  if (next)
  {
    next->state_ = Connection::State::OPEN;
    for (; next->held_back_ > 0; --next->held_back_)
    {
      next->queueCallback();
    }
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
  if (!is_connected && now - committed < PATIENCE)
  {
    later([self = shared_from_this(), next, committed] { self->switchIfDue(next, committed); }, now + STEP);
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
  topics::unsubscribeDraining(lock, connection->topic, connection);
}

}  // namespace dyknow
