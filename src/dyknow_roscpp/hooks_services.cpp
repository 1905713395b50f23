// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The hooks of services: loads and unloads of nodelets in C++ are under the guards of this process, and a
/// nodelet takes away no service but its own.
#include <nodelet/NodeletLoad.h>
#include <nodelet/NodeletUnload.h>
#include <ros/advertise_service_options.h>
#include <ros/console.h>
#include <ros/names.h>
#include <ros/node_handle.h>
#include <ros/service_callback_helper.h>
#include <ros/service_manager.h>
#include <ros/service_publication.h>
#include <ros/this_node.h>

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

using AdvertiseServiceMethod = ros::ServiceServer (ros::NodeHandle::*)(ros::AdvertiseServiceOptions&);

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

}  // namespace

/// Names the private method, see symbols.h.
struct UnregisterService
{
  using Method = bool (ros::ServiceManager::*)(const std::string&);
  friend void* addressOfPrivate(UnregisterService);
};

/// Name the private list of what is offered, and its lock.
struct Offered
{
  using Member = ros::L_ServicePublication ros::ServiceManager::*;
  friend Member pointerTo(Offered);
};

struct OfferedLock
{
  using Member = boost::mutex ros::ServiceManager::*;
  friend Member pointerTo(OfferedLock);
};

template struct PrivateMethod<UnregisterService, &ros::ServiceManager::unregisterService>;
template struct PrivateMember<Offered, &ros::ServiceManager::service_publications_>;
template struct PrivateMember<OfferedLock, &ros::ServiceManager::service_publications_mutex_>;

namespace
{

/// The services that handles offer, by the keys of these (see Registry).
///
/// roscpp withdraws a service by its name. A nodelet that is unloaded while a callback of it runs is destroyed when
/// that returns, and would take away the service of one that has been loaded under its name meanwhile.
class OfferedServices
{
public:
  static OfferedServices& instance()
  {
    static OfferedServices& services = *new OfferedServices;  // leaked, see later.cpp
    return services;
  }

  void enter(const std::string& key, const ros::CallbackQueueInterface* queue)
  {
    const auto* owner = Registry::instance().nodeletOf(queue).empty() ? RunningQueue::current() : queue;
    const auto offered = ros::ServiceManager::instance()->lookupServicePublication(Registry::topicOf(key));
    std::lock_guard<std::mutex> lock(state_lock_);
    services_[key] = {owner, offered, nullptr};
  }

  ros::ServicePublicationPtr leave(const std::string& key)
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    const auto found = services_.find(key);
    auto offered = found == services_.end() ? nullptr : found->second.offered.lock();
    services_.erase(key);
    return offered;
  }

  /// Returns the services of a nodelet, which are kept from now on until their handles leave.
  std::vector<ros::ServicePublicationPtr> keep(const ros::CallbackQueueInterface* queue)
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    std::vector<ros::ServicePublicationPtr> found;
    for (auto& [key, each] : services_)
    {
      if (each.owner == queue && (each.kept = each.offered.lock()))
      {
        found.push_back(each.kept);
      }
    }
    return found;
  }

private:
  struct Service
  {
    const ros::CallbackQueueInterface* owner;          ///< the queue of its nodelet
    boost::weak_ptr<ros::ServicePublication> offered;  ///< which ends with roscpp, maybe long before the handle
    ros::ServicePublicationPtr kept;
  };

  std::mutex state_lock_;
  std::map<std::string, Service> services_;
};

/// Takes a service out of roscpp's list and the master's; false if it is not there any more. Its calls go on.
bool withdraw(const ros::ServicePublicationPtr& service)
{
  using Unregister = bool (*)(ros::ServiceManager*, const std::string&);
  static const auto unregister = reinterpret_cast<Unregister>(addressOfPrivate(UnregisterService()));
  auto& manager = *ros::ServiceManager::instance();
  {
    const boost::mutex::scoped_lock lock(manager.*pointerTo(OfferedLock()));
    auto& offered = manager.*pointerTo(Offered());
    const auto found = std::find(offered.begin(), offered.end(), service);
    if (found == offered.end())
    {
      return false;
    }
    offered.erase(found);
  }
  unregister(&manager, service->getName());
  return true;
}

}  // namespace

void withdrawServicesOf(const ros::CallbackQueueInterface* queue)
{
  // Does not wait for the calls, of which one may wait for this unload. The handle ends them.
  for (const auto& service : OfferedServices::instance().keep(queue))
  {
    withdraw(service);
  }
}

std::vector<void*> serviceHooks()
{
  return {
      addressOf(static_cast<AdvertiseServiceMethod>(&ros::NodeHandle::advertiseService)),
      addressOf(&ros::ServiceManager::advertiseService),
      addressOf(&ros::ServiceManager::unadvertiseService),
      addressOf(&ros::ServiceServer::getService),
  };
}

}  // namespace dyknow

namespace ros
{

ServiceServer NodeHandle::advertiseService(AdvertiseServiceOptions& ops)
{
  static const auto next = dyknow::behind(static_cast<dyknow::AdvertiseServiceMethod>(&NodeHandle::advertiseService));
  if (!dyknow::areHooksReached())
  {
    return next(this, ops);
  }
  const std::string resolved = resolveName(ops.service);
  ops.service = dyknow::Registry::instance().makeKey(resolved);
  auto server = next(this, ops);
  ops.service = resolved;
  return server;
}

bool ServiceManager::advertiseService(const AdvertiseServiceOptions& ops)
{
  static const auto next = dyknow::behind(&ServiceManager::advertiseService);
  AdvertiseServiceOptions options = ops;
  options.service = dyknow::Registry::topicOf(ops.service);
  if (const auto check = dyknow::checkOf(ops.datatype))
  {
    if (dyknow::areHooksReached())
    {
      dyknow::offerManagerServices();  // first: clients of the loader's services know its kind
    }
    options.helper = boost::make_shared<dyknow::GuardedCallback>(ops.helper, check);
  }
  const bool is_of_handle = dyknow::Registry::isKey(ops.service);
  if (is_of_handle)
  {
    const std::string nodelet = dyknow::Registry::instance().nodeletOf(ops.callback_queue);
    dyknow::giveWay(options.service, nodelet.empty() ? this_node::getName() : nodelet);
  }
  const bool is_advertised = next(this, options);
  if (is_advertised && is_of_handle)
  {
    dyknow::OfferedServices::instance().enter(ops.service, ops.callback_queue);
  }
  return is_advertised;
}

bool ServiceManager::unadvertiseService(const std::string& service)
{
  static const auto next = dyknow::behind(&ServiceManager::unadvertiseService);
  if (!dyknow::Registry::isKey(service))
  {
    return next(this, service);
  }
  const auto offered = dyknow::OfferedServices::instance().leave(service);
  if (!offered)
  {
    return false;
  }
  const bool was_offered = dyknow::withdraw(offered);
  if (!offered->isDropped())
  {
    offered->drop();
  }
  return was_offered;
}

std::string ServiceServer::getService() const
{
  static const auto next = dyknow::behind(&ServiceServer::getService);
  return dyknow::Registry::topicOf(next(this));
}

}  // namespace ros
