// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The hook of services: loads and unloads of nodelets in C++ are under the guards of this process.
#include <nodelet/NodeletLoad.h>
#include <nodelet/NodeletUnload.h>
#include <ros/advertise_service_options.h>
#include <ros/console.h>
#include <ros/names.h>
#include <ros/service_callback_helper.h>
#include <ros/service_manager.h>

#include <algorithm>
#include <cstring>
#include <utility>
#include <vector>

#include "guards.h"
#include "names.h"
#include "problems.h"
#include "process_services.h"
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

}  // namespace

}  // namespace dyknow

namespace ros
{

bool ServiceManager::advertiseService(const AdvertiseServiceOptions& ops)
{
  static const auto next = dyknow::behind(&ServiceManager::advertiseService);
  const auto check = dyknow::checkOf(ops.datatype);
  if (check == nullptr)
  {
    return next(this, ops);
  }
  if (dyknow::areHooksReached())
  {
    dyknow::offerManagerServices();  // first: clients of the loader's services know its kind
  }
  AdvertiseServiceOptions guarded = ops;
  guarded.helper = boost::make_shared<dyknow::GuardedCallback>(ops.helper, check);
  return next(this, guarded);
}

}  // namespace ros
