// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Hooks of libnodeletlib's functions, which identify the owner of a handle.
///
/// The library is not linked with it: with LD_PRELOAD it comes into nodes that have no nodelets.
#include <nodelet/detail/callback_queue.h>
#include <nodelet/detail/callback_queue_manager.h>
#include <nodelet/nodelet.h>
#include <ros/names.h>

#include <iterator>
#include <map>
#include <mutex>
#include <vector>

#include "guards.h"
#include "process_services.h"
#include "registry.h"
#include "self_check.h"
#include "stuck_callbacks.h"
#include "symbols.h"

namespace dyknow
{

namespace
{

/// Queues of nodelets that are unloaded, each until its nodelet is destroyed.
///
/// A nodelet that is unloaded while a callback of it runs is destroyed at the end of that callback. Its handles
/// then still use both of its queues, of which the loader has let go by then.
class KeptQueues
{
public:
  static KeptQueues& instance()
  {
    static KeptQueues& kept = *new KeptQueues;  // leaked, see later.cpp
    return kept;
  }

  void enter(const nodelet::Nodelet* nodelet, const std::vector<ros::CallbackQueueInterface*>& queues)
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    for (const auto* queue : queues)
    {
      nodelets_[queue] = nodelet;
    }
  }

  /// The loader lets go of a queue.
  void keep(const nodelet::detail::CallbackQueuePtr& queue)
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    if (const auto found = nodelets_.find(queue.get()); found != nodelets_.end())
    {
      kept_[found->second].push_back(queue);
      nodelets_.erase(found);
    }
  }

  /// The nodelet is destroyed.
  void leave(const nodelet::Nodelet* nodelet)
  {
    std::vector<nodelet::detail::CallbackQueuePtr> gone;  // destroyed without the lock
    {
      std::lock_guard<std::mutex> lock(state_lock_);
      for (auto each = nodelets_.begin(); each != nodelets_.end();)
      {
        each = each->second == nodelet ? nodelets_.erase(each) : std::next(each);
      }
      gone.swap(kept_[nodelet]);
      kept_.erase(nodelet);
    }
    for (const auto& queue : gone)
    {
      Registry::instance().forget(queue.get());
    }
  }

private:
  std::mutex state_lock_;
  std::map<const ros::CallbackQueueInterface*, const nodelet::Nodelet*> nodelets_;
  std::map<const nodelet::Nodelet*, std::vector<nodelet::detail::CallbackQueuePtr>> kept_;
};

}  // namespace

/// Stands in front of nodelet::Nodelet::~Nodelet as the destructors of nodelets call it, when their own members are
/// gone. A destructor of C++ would destroy the members that the one behind it destroys.
__attribute__((visibility("default"))) void destroyNodelet(nodelet::Nodelet* nodelet) __asm__(
    "_ZN7nodelet7NodeletD2Ev");

void destroyNodelet(nodelet::Nodelet* nodelet)
{
  static const auto next = behind(&destroyNodelet);
  next(nodelet);
  KeptQueues::instance().leave(nodelet);
}

std::vector<void*> nodeletHooks()
{
  return {
      addressOf(&nodelet::Nodelet::init),
      reinterpret_cast<void*>(&destroyNodelet),
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
  dyknow::KeptQueues::instance().enter(this, {st_queue, mt_queue});
  const auto proxy =
      dyknow::Registry::instance().enter(ros::names::resolve(name), remapping_args, {st_queue, mt_queue});
  {
    const dyknow::RunningQueue running(st_queue);
    next(this, name, remapping_args, my_argv, st_queue, mt_queue);  // if it throws, see removeQueue
  }
  proxy->loader = dyknow::Guards::loader();
  dyknow::offerServices(proxy);
  dyknow::watchCallbacks();
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
  // The loader does so before it destroys the nodelet, also if its onInit has failed, for each of its two queues.
  if (const auto gone = dyknow::Registry::instance().leave(queue.get()))
  {
    dyknow::withdrawServices(*gone);
  }
  dyknow::withdrawServicesOf(queue.get());
  next(this, queue);
  dyknow::KeptQueues::instance().keep(queue);
}

}  // namespace detail
}  // namespace nodelet
