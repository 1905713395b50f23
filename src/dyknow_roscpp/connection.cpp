// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "connection.h"

#include "port_subscription.h"

namespace dyknow
{

Connection::Connection(std::weak_ptr<PortSubscription> subscription,
                       ros::SubscriptionCallbackHelperPtr original, ros::CallbackQueueInterface* queue,
                       std::string topic, State state)
  : topic(std::move(topic))
  , subscription_(std::move(subscription))
  , original_(std::move(original))
  , queue_(queue)
  , state_(state)
{
}

ros::VoidConstPtr Connection::deserialize(const ros::SubscriptionCallbackHelperDeserializeParams& params)
{
  return original_->deserialize(params);
}

void Connection::call(ros::SubscriptionCallbackHelperCallParams& params)
{
  if (const auto subscription = subscription_.lock())
  {
    subscription->deliver(*this, params);
  }
}

const std::type_info& Connection::getTypeInfo()
{
  return original_->getTypeInfo();
}

bool Connection::isConst()
{
  return original_->isConst();
}

bool Connection::hasHeader()
{
  return original_->hasHeader();
}

void Connection::addCallback(const ros::CallbackInterfacePtr& callback, std::uint64_t)
{
  const auto subscription = subscription_.lock();
  if (!subscription)
  {
    return;
  }
  const std::lock_guard<std::mutex> queueing(subscription->queueing_lock_);
  {
    const std::lock_guard<std::mutex> lock(subscription->state_lock_);
    if (callback_ != callback)  // otherwise nothing is written that other processors have in their caches
    {
      callback_ = callback;
    }
    if (state_ == State::HELD)
    {
      ++held_back_;
      return;
    }
    if (state_ == State::CLOSED || !subscription->is_open_)
    {
      return;
    }
  }
  queueCallback();
}

void Connection::queueCallback()
{
  // An id of our own: roscpp's is the address of an object that is gone while we still drain.
  queue_->addCallback(callback_, reinterpret_cast<std::uint64_t>(this));
}

}  // namespace dyknow
