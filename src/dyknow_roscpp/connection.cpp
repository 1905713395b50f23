// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "connection.h"

#include "port_subscription.h"

namespace dyknow
{

Connection::Connection(std::shared_ptr<PortSubscription> subscription, const ros::SubscribeOptions& options,
                       std::string topic, std::uint32_t number, State state)
  : subscription_(std::move(subscription))
  , original_(options.helper)
  , type_(original_->getTypeInfo())
  , queue_(options.callback_queue)
  , queue_size_(options.queue_size)
  , number_(number)
  , state_(state)
  , topic(std::move(topic))
{
}

bool Connection::take(QueuedMessage&& message)
{
  return subscription_->take(std::move(message));
}

ros::VoidConstPtr Connection::deserialize(const ros::SubscriptionCallbackHelperDeserializeParams& params)
{
  return original_->deserialize(params);
}

void Connection::call(ros::SubscriptionCallbackHelperCallParams& params)
{
  original_->call(params);
}

const std::type_info& Connection::getTypeInfo()
{
  return type_;
}

bool Connection::isConst()
{
  return original_->isConst();
}

bool Connection::hasHeader()
{
  return original_->hasHeader();
}

ros::CallbackInterface::CallResult Connection::call()
{
  return subscription_->deliver(*this);
}

}  // namespace dyknow
