// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "reconfiguration.h"

#include <ros/console.h>

#include <atomic>

#include "process_services.h"
#include "registry.h"
#include "self_check.h"

namespace dyknow
{
namespace
{

class Call : public ros::CallbackInterface
{
public:
  Call(std::shared_ptr<const ReconfigureListener> listener, PortTopics inputs, PortTopics outputs)
    : listener_(std::move(listener))
    , inputs_(std::move(inputs))
    , outputs_(std::move(outputs))
  {
  }

  CallResult call() override
  {
    listener_->call(inputs_, outputs_);
    return Success;
  }

private:
  const std::shared_ptr<const ReconfigureListener> listener_;
  const PortTopics inputs_;
  const PortTopics outputs_;
};

}  // namespace

void ReconfigureListener::set(ReconfigureCallback callback, ros::CallbackQueueInterface* queue)
{
  std::lock_guard<std::mutex> lock(state_lock_);
  callback_.swap(callback);
  queue_ = queue;
}

Announcement ReconfigureListener::announcement(PortTopics inputs, PortTopics outputs)
{
  const auto is_done = std::make_shared<std::atomic<bool>>(false);
  return [self = shared_from_this(), inputs = std::move(inputs), outputs = std::move(outputs), is_done]
  {
    if (!is_done->exchange(true))
    {
      self->queue(inputs, outputs);
    }
  };
}

void ReconfigureListener::call(const PortTopics& inputs, const PortTopics& outputs) const
{
  ReconfigureCallback callback;
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    callback = callback_;
  }
  if (!callback)
  {
    return;
  }
  try
  {
    callback(inputs, outputs);
  }
  catch (const std::exception& error)
  {
    ROS_ERROR("reconfigure callback: %s", error.what());
  }
}

void ReconfigureListener::queue(const PortTopics& inputs, const PortTopics& outputs)
{
  std::lock_guard<std::mutex> lock(state_lock_);
  if (callback_)
  {
    queue_->addCallback(boost::make_shared<Call>(shared_from_this(), inputs, outputs),
                        reinterpret_cast<std::uint64_t>(this));
  }
}

}  // namespace dyknow

/// Found by dyknow/node_handle.h with dlsym.
extern "C" __attribute__((visibility("default"))) bool dyknow_set_reconfigure_callback(
    ros::NodeHandle& handle, dyknow::ReconfigureCallback callback)
{
  if (!dyknow::areHooksReached())
  {
    return false;
  }
  const auto owner = dyknow::Registry::instance().ownerOf(handle, nullptr);
  owner->listener->set(std::move(callback), handle.getCallbackQueue());
  return true;
}
