// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The hooks of services: loads and unloads of nodelets in C++ are under the guards of this process, and a
/// nodelet takes away no service but its own.
#include <nodelet/NodeletLoad.h>
#include <nodelet/NodeletUnload.h>
#include <ros/advertise_service_options.h>
#include <ros/console.h>
#include <ros/names.h>
#include <ros/service_callback_helper.h>
#include <ros/service_manager.h>

#include <algorithm>
#include <cstring>
#include <map>
#include <mutex>
#include <utility>
#include <vector>

#include "guards.h"
#include "names.h"
#include "problems.h"
#include "process_services.h"
#include "registry.h"
#include "self_check.h"
#include "symbols.h"

namespace dyknow
{
namespace
{

using Check = void (*)(const ros::ServiceCallbackHelperCallParams&, const Guards&, const std::string& caller);

/// The answer of a service that fails with a text.
ros::SerializedMessage failure(const std::string& text)
{
  const auto length = static_cast<std::uint32_t>(text.size());
  const boost::shared_array<std::uint8_t> bytes(new std::uint8_t[1 + sizeof(length) + length]);
  bytes[0] = 0;
  std::memcpy(bytes.get() + 1, &length, sizeof(length));
  std::memcpy(bytes.get() + 1 + sizeof(length), text.data(), length);
  return {bytes, 1 + sizeof(length) + length};
}

/// Stands in front of a service's callback.
class GuardedCallback : public ros::ServiceCallbackHelper
{
public:
  GuardedCallback(ros::ServiceCallbackHelperPtr next, Check check) : next_(std::move(next)), check_(check) {}

  bool call(ros::ServiceCallbackHelperCallParams& params) override
  {
    const std::string caller = (*params.connection_header)["callerid"];
    try
    {
      check_(params, Guards::current(), caller);
    }
    catch (const Refusal& refusal)
    {
      ROS_ERROR("%s", refusal.what());
      params.response = failure(refusal.what());
      return true;
    }
    const Guards::Loading loading(caller);
    return next_->call(params);
  }

private:
  const ros::ServiceCallbackHelperPtr next_;
  const Check check_;
};

void checkLoad(const ros::ServiceCallbackHelperCallParams& params, const Guards& guards,
               const std::string& caller)
{
  nodelet::NodeletLoad::Request request;
  ros::serialization::deserializeMessage(params.request, request);
  std::vector<std::string> texts{request.name, request.type, request.bond_id};
  std::size_t entries = 0;
  for (const auto* each : {&request.remap_source_args, &request.remap_target_args, &request.my_argv})
  {
    texts.insert(texts.end(), each->begin(), each->end());
    entries = std::max(entries, each->size());
  }
  guards.checkSizes(texts, entries);
  const std::string name = ros::names::resolve(request.name);
  guards.checkCaller(caller, "loading '" + name + "'");
  for (const auto& target : request.remap_target_args)
  {
    const std::string topic = ros::names::resolve(target);
    if (!names::isDisconnected(topic, name))
    {
      guards.checkTopic(topic);
    }
  }
}

void checkUnload(const ros::ServiceCallbackHelperCallParams& params, const Guards& guards,
                 const std::string& caller)
{
  nodelet::NodeletUnload::Request request;
  ros::serialization::deserializeMessage(params.request, request);
  guards.checkSizes({request.name}, 0);
  const std::string name = ros::names::resolve(request.name);
  guards.checkCaller(caller, "unloading '" + name + "'");
  guards.checkProtection(caller, name);
}

Check checkOf(const std::string& datatype)
{
  return datatype == "nodelet/NodeletLoad" ? checkLoad : datatype == "nodelet/NodeletUnload" ? checkUnload : nullptr;
}

/// The services of nodelets, each with the callback queue of its nodelet.
///
/// roscpp withdraws a service by its name. A nodelet that is unloaded while a callback of it runs is destroyed when
/// that returns, and would take away the services of one that has been loaded under its name meanwhile.
class ServicesOfNodelets
{
public:
  static ServicesOfNodelets& instance()
  {
    static ServicesOfNodelets& services = *new ServicesOfNodelets;  // leaked, see later.cpp
    return services;
  }

  void enter(const std::string& service, const ros::CallbackQueueInterface* queue)
  {
    const auto* owner = Registry::instance().nodeletOf(queue).empty() ? RunningQueue::current() : queue;
    std::lock_guard<std::mutex> lock(state_lock_);
    queues_[service] = owner;
  }

  /// Takes a service out for this thread; false if it is another nodelet's by now.
  bool leave(const std::string& service)
  {
    const auto* running = RunningQueue::current();
    const bool is_unloaded = running != nullptr && Registry::instance().nodeletOf(running).empty();
    std::lock_guard<std::mutex> lock(state_lock_);
    const auto found = queues_.find(service);
    if (found == queues_.end())
    {
      return true;
    }
    if (is_unloaded && found->second != running)
    {
      return false;
    }
    queues_.erase(found);
    return true;
  }

  std::vector<std::string> of(const ros::CallbackQueueInterface* queue) const
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    std::vector<std::string> services;
    for (const auto& [service, owner] : queues_)
    {
      if (owner == queue)
      {
        services.push_back(service);
      }
    }
    return services;
  }

private:
  mutable std::mutex state_lock_;
  std::map<std::string, const ros::CallbackQueueInterface*> queues_;
};

}  // namespace

void withdrawServicesOf(const ros::CallbackQueueInterface* queue)
{
  for (const auto& service : ServicesOfNodelets::instance().of(queue))
  {
    ros::ServiceManager::instance()->unadvertiseService(service);
  }
}

}  // namespace dyknow

namespace ros
{

bool ServiceManager::advertiseService(const AdvertiseServiceOptions& ops)
{
  static const auto next = dyknow::behind(&ServiceManager::advertiseService);
  const auto check = dyknow::checkOf(ops.datatype);
  if (check == nullptr)
  {
    const bool is_advertised = next(this, ops);
    if (is_advertised)
    {
      dyknow::ServicesOfNodelets::instance().enter(ops.service, ops.callback_queue);
    }
    return is_advertised;
  }
  if (dyknow::areHooksReached())
  {
    dyknow::offerManagerServices();  // first: clients of the loader's services know its kind
  }
  AdvertiseServiceOptions guarded = ops;
  guarded.helper = boost::make_shared<dyknow::GuardedCallback>(ops.helper, check);
  return next(this, guarded);
}

bool ServiceManager::unadvertiseService(const std::string& service)
{
  static const auto next = dyknow::behind(&ServiceManager::unadvertiseService);
  return !dyknow::ServicesOfNodelets::instance().leave(service) || next(this, service);
}

}  // namespace ros
