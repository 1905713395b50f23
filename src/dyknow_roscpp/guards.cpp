// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "guards.h"

#include <fnmatch.h>
#include <ros/console.h>
#include <ros/this_node.h>

#include <algorithm>
#include <cstdlib>
#include <mutex>

#include "master.h"
#include "names.h"
#include "problems.h"

namespace dyknow
{
namespace
{

/// The environment variable of programs that a DyKnow manager starts, see guard_parameters.py.
constexpr const char* SPAWNED = "DYKNOW_SPAWNED";

/// The key under which a manager hands over its guards, see dyknow/ros/nodelets/guard_parameters.py.
std::string keyOf(const std::string& owner)
{
  std::string key;
  const auto begin = owner.find_first_not_of('/');
  const auto end = owner.find_last_not_of('/');
  for (auto i = begin; begin != std::string::npos && i <= end; ++i)
  {
    key += owner[i] == '_' ? "__" : owner[i] == '/' ? "_s" : std::string(1, owner[i]);
  }
  return key;
}

/// Characters of a text in UTF-8.
std::size_t lengthOf(const std::string& text)
{
  return std::count_if(text.begin(), text.end(), [](unsigned char each) { return (each & 0xc0) != 0x80; });
}

/// The texts of an array; empty if it is none.
std::vector<std::string> textsOf(XmlRpc::XmlRpcValue& values)
{
  std::vector<std::string> texts;
  for (int i = 0; values.getType() == XmlRpc::XmlRpcValue::TypeArray && i < values.size(); ++i)
  {
    if (values[i].getType() == XmlRpc::XmlRpcValue::TypeString)
    {
      texts.push_back(values[i]);
    }
  }
  return texts;
}

bool matchesAny(const std::string& topic, const std::vector<std::string>& patterns)
{
  return std::any_of(patterns.begin(), patterns.end(), [&topic](const auto& pattern)
                     { return fnmatch(pattern.c_str(), topic.c_str(), FNM_NOESCAPE) == 0; });
}

Refusal tooMany(const std::string& what, std::size_t count, std::size_t limit)
{
  return Refusal(shared::LIMIT_EXCEEDED, {what, std::to_string(count), std::to_string(limit)});
}

void lower(std::size_t& limit, XmlRpc::XmlRpcValue& guards, const char* name)
{
  if (guards.hasMember(name) && guards[name].getType() == XmlRpc::XmlRpcValue::TypeInt)
  {
    limit = std::min(limit, static_cast<std::size_t>(std::max(0, static_cast<int>(guards[name]))));
  }
}

}  // namespace

Guards Guards::current(Clock::time_point deadline)
{
  Guards all;
  auto by_owner = askMaster("getParam", names::join(ros::this_node::getName(), "guards"), deadline);
  if (by_owner.getType() != XmlRpc::XmlRpcValue::TypeStruct)
  {
    return all;
  }
  for (auto& [owner, guards] : by_owner)
  {
    if (guards.getType() != XmlRpc::XmlRpcValue::TypeStruct)
    {
      continue;
    }
    for (const auto& pattern : textsOf(guards["denied_topics"]))
    {
      all.denied_topics_.insert(pattern);
    }
    auto& allowed = guards["allowed_topics"];
    for (int i = 0; allowed.getType() == XmlRpc::XmlRpcValue::TypeArray && i < allowed.size(); ++i)
    {
      all.allowed_topics_.push_back(textsOf(allowed[i]));
    }
    for (const auto& nodelet : textsOf(guards["protected"]))
    {
      all.protected_[owner].insert(nodelet);
    }
    if (guards.hasMember("read_only") && guards["read_only"].getType() == XmlRpc::XmlRpcValue::TypeBoolean &&
        static_cast<bool>(guards["read_only"]))
    {
      all.read_only_owners_.insert(owner);
    }
    lower(all.string_length_, guards, "string_length");
    lower(all.array_length_, guards, "array_length");
  }
  return all;
}

std::string Guards::permitted(const std::string& topic, const std::string& owner)
{
  static std::mutex& state_lock = *new std::mutex;  // leaked, see later.cpp
  static Guards& last = *new Guards;
  static const bool is_spawned = std::getenv(SPAWNED) != nullptr;
  if (topic.empty() || (owner == ros::this_node::getName() && !is_spawned))
  {
    return topic;
  }
  try
  {
    const Guards now = current(Clock::now() + MASTER_PATIENCE);
    std::lock_guard<std::mutex> lock(state_lock);
    last = now;
  }
  catch (const Refusal& refusal)
  {
    ROS_WARN("dyknow: %s: guards may have changed", refusal.what());
  }
  try
  {
    std::lock_guard<std::mutex> lock(state_lock);
    last.checkTopic(topic);
  }
  catch (const Refusal& refusal)
  {
    ROS_ERROR("%s: not connected: %s", owner.c_str(), refusal.what());
    return "";
  }
  return topic;
}

void Guards::checkProtection(const std::string& caller, const std::string& nodelet) const
{
  for (const auto& [owner, nodelets] : protected_)
  {
    if (owner != keyOf(caller) && nodelets.count(nodelet) > 0)
    {
      throw Refusal(shared::PROTECTED_FROM_UNLOADING, {nodelet});
    }
  }
}

void Guards::checkCaller(const std::string& caller, const std::string& what) const
{
  if (!read_only_owners_.empty() && read_only_owners_.count(keyOf(caller)) == 0)
  {
    throw Refusal(shared::READ_ONLY, {what});
  }
}

void Guards::checkTopic(const std::string& topic) const
{
  for (const auto& pattern : denied_topics_)
  {
    if (fnmatch(pattern.c_str(), topic.c_str(), FNM_NOESCAPE) == 0)
    {
      throw Refusal(shared::DENIED, {topic, pattern});
    }
  }
  for (const auto& patterns : allowed_topics_)
  {
    if (!matchesAny(topic, patterns))
    {
      throw Refusal(shared::NOT_ALLOWED, {topic});
    }
  }
}

void Guards::checkSizes(const std::vector<std::string>& strings, std::size_t entries) const
{
  if (entries > array_length_)
  {
    throw tooMany("entries in an array", entries, array_length_);
  }
  for (const auto& each : strings)
  {
    if (lengthOf(each) > string_length_)
    {
      throw tooMany("characters in a string", lengthOf(each), string_length_);
    }
  }
}

}  // namespace dyknow
