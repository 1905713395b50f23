// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Hooks of libnodeletlib's functions, which tell whose handle it is.
///
/// The library is not linked with it: with LD_PRELOAD it comes into nodes that have no nodelets.
#include <nodelet/detail/callback_queue.h>
#include <nodelet/detail/callback_queue_manager.h>
#include <nodelet/nodelet.h>
#include <ros/names.h>

#include "later.h"
#include "private_member.h"
#include "probe.h"
#include "process_services.h"
#include "registry.h"
#include "self_check.h"
#include "symbols.h"

namespace dyknow
{

/// Names the private weak pointer to the nodelet of a queue, see private_member.h.
struct TrackedOf
{
  using Member = ros::VoidConstWPtr nodelet::detail::CallbackQueue::*;
  friend Member pointerTo(TrackedOf);
};

template struct PrivateMember<TrackedOf, &nodelet::detail::CallbackQueue::tracked_object_>;

namespace
{

constexpr std::chrono::milliseconds STEP(500);

/// Keeps a queue until its nodelet is gone. A nodelet that is unloaded while a callback of it runs is destroyed
/// at the end of that callback, and its handles then still use both of its queues; the loader has let go of
/// the other one by then.
void keepForNodelet(const nodelet::detail::CallbackQueuePtr& queue)
{
  if (!(queue.get()->*pointerTo(TrackedOf())).expired())
  {
    later([queue] { keepForNodelet(queue); }, Clock::now() + STEP);
  }
}

}  // namespace

std::vector<void*> nodeletHooks()
{
  return {
      addressOf(&nodelet::Nodelet::init),
      addressOf(&nodelet::detail::CallbackQueue::callOne),
      addressOf(&nodelet::detail::CallbackQueueManager::removeQueue),
  };
}

}  // namespace dyknow

namespace nodelet
{

void Nodelet::init(const std::string& name, const M_string& remapping_args, const V_string& my_argv,
                   ros::CallbackQueueInterface* st_queue, ros::CallbackQueueInterface* mt_queue)
{
  static const auto next = dyknow::behind(&Nodelet::init);
  if (st_queue == nullptr || !dyknow::areHooksReached())
  {
    next(this, name, remapping_args, my_argv, st_queue, mt_queue);
    return;
  }
  auto& registry = dyknow::Registry::instance();
  const auto proxy = registry.enter(ros::names::resolve(name), remapping_args, {st_queue, mt_queue});
  try
  {
    const dyknow::RunningQueue running(st_queue);
    next(this, name, remapping_args, my_argv, st_queue, mt_queue);
  }
  catch (...)
  {
    registry.leave(st_queue);
    registry.leave(mt_queue);
    throw;
  }
  dyknow::offerServices(proxy);
}

namespace detail
{

std::uint32_t CallbackQueue::callOne()
{
  static const auto next = dyknow::behind(&CallbackQueue::callOne);
  const dyknow::RunningQueue running(this);
  return next(this);
}

void CallbackQueueManager::removeQueue(const CallbackQueuePtr& queue)
{
  static const auto next = dyknow::behind(&CallbackQueueManager::removeQueue);
  // The loader does so before it destroys the nodelet, for each of its two queues.
  if (const auto gone = dyknow::Registry::instance().leave(queue.get()))
  {
    dyknow::withdrawServices(*gone);
  }
  next(this, queue);
  dyknow::keepForNodelet(queue);
}

}  // namespace detail
}  // namespace nodelet
