// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Hooks of libnodeletlib's functions, which tell whose handle it is.
///
/// The library is not linked with it: with LD_PRELOAD it comes into nodes that have no nodelets.
#include <nodelet/detail/callback_queue.h>
#include <nodelet/detail/callback_queue_manager.h>
#include <nodelet/nodelet.h>
#include <ros/names.h>

#include "probe.h"
#include "process_services.h"
#include "registry.h"
#include "self_check.h"
#include "symbols.h"

namespace dyknow
{

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
}

}  // namespace detail
}  // namespace nodelet
