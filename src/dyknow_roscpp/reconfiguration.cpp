// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "reconfiguration.h"

#include <ros/console.h>

#include <utility>

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
  Call(std::shared_ptr<const ReconfigureListener> listener, std::shared_ptr<const PortMaps> maps)
    : listener_(std::move(listener))
    , maps_(std::move(maps))
  {
  }

  CallResult call() override
  {
    listener_->call(*maps_);
    return Success;
  }

private:
  const std::shared_ptr<const ReconfigureListener> listener_;
  const std::shared_ptr<const PortMaps> maps_;
};

}  // namespace

Announcement::Announcement(std::shared_ptr<ReconfigureListener> listener, PortMaps maps)
  : listener_(std::move(listener))
  , maps_(std::make_shared<PortMaps>(std::move(maps)))
{
}

void Announcement::make()
{
  if (!is_made_.exchange(true))
  {
    listener_->queue(maps_);
  }
}

bool Announcement::isMade() const
{
  return is_made_ || listener_->queued() >= maps_->change;
}

void ReconfigureListener::set(ReconfigureCallback callback, ros::CallbackQueueInterface* queue)
{
  std::lock_guard<std::mutex> lock(state_lock_);
  callback_.swap(callback);
  queue_ = queue;
}

bool ReconfigureListener::isSet() const
{
  std::lock_guard<std::mutex> lock(state_lock_);
  return static_cast<bool>(callback_);
}

void ReconfigureListener::queue(const std::shared_ptr<const PortMaps>& maps)
{
  std::lock_guard<std::mutex> lock(state_lock_);
  if (!latest_ || latest_->change < maps->change)
  {
    latest_ = maps;
    queued_ = maps->change;
  }
  if (callback_)
  {
    queue_->addCallback(boost::make_shared<Call>(shared_from_this(), latest_),
                        reinterpret_cast<std::uint64_t>(this));
  }
}

void ReconfigureListener::call(const PortMaps& maps) const
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
    callback(maps.inputs, maps.outputs);
  }
  catch (const std::exception& error)
  {
    ROS_ERROR("reconfigure callback: %s", error.what());
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
