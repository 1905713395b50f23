// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "guards.h"

#include <fnmatch.h>
#include <ros/console.h>
#include <ros/param.h>
#include <ros/serialization.h>
#include <ros/this_node.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <iterator>
#include <mutex>
#include <set>
#include <sstream>

#include "dyknow_shared.h"
#include "names.h"
#include "problems.h"

namespace dyknow
{
namespace
{

/// Environment variables of programs that a DyKnow manager starts, see process_guards.py.
constexpr const char* SPAWNED = "DYKNOW_SPAWNED";
constexpr const char* GUARDS = "DYKNOW_GUARDS";

/// Node that requested the nodelet that this thread makes.
thread_local const std::string* t_loader = nullptr;
std::atomic<bool> is_rewirable{true};

/// Characters of a text in UTF-8.
std::size_t lengthOf(const std::string& text)
{
  return std::count_if(text.begin(), text.end(), [](unsigned char each) { return (each & 0xc0) != 0x80; });
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

/// Guards in the environment: a manager, and the message in hexadecimal digits.
std::map<std::string, dyknow_msgs::Guards> guardsAtStart()
{
  std::map<std::string, dyknow_msgs::Guards> found;
  const char* text = std::getenv(GUARDS);
  std::istringstream words(text == nullptr ? "" : text);
  std::string manager;
  std::string digits;
  if (words >> manager >> digits)
  {
    std::vector<std::uint8_t> bytes;
    for (std::size_t i = 0; i + 1 < digits.size(); i += 2)
    {
      bytes.push_back(static_cast<std::uint8_t>(std::stoi(digits.substr(i, 2), nullptr, 16)));
    }
    ros::serialization::IStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
    ros::serialization::deserialize(stream, found[manager]);
  }
  return found;
}

/// The guards of this process, and their lock.
struct Handed
{
  std::mutex state_lock;
  std::map<std::string, dyknow_msgs::Guards> by_manager = guardsAtStart();
};

Handed& handed()
{
  static auto& handed = *new Handed;  // leaked, see later.cpp
  return handed;
}

}  // namespace

std::string Guards::starter()
{
  std::string manager;
  const char* text = std::getenv(GUARDS);
  std::istringstream(text == nullptr ? "" : text) >> manager;
  return manager;
}

Guards::Loading::Loading(const std::string& caller)
{
  t_loader = &caller;
}

Guards::Loading::~Loading()
{
  t_loader = nullptr;
}

std::string Guards::loader()
{
  return t_loader == nullptr ? starter() : *t_loader;
}

void Guards::readRewirable()
{
  XmlRpc::XmlRpcValue value;
  if (!ros::param::get(names::join(ros::this_node::getName(), "rewirable"), value))
  {
    value = true;
  }
  const bool is_flag = value.getType() == XmlRpc::XmlRpcValue::TypeBoolean;
  is_rewirable = is_flag && static_cast<bool>(value);
  if (!is_flag)
  {
    ROS_ERROR_STREAM_ONCE("parameter '~rewirable' is " << value << ": expected true or false; false is taken");
  }
}

void Guards::checkRewirable(const std::string& what)
{
  if (!is_rewirable)
  {
    throw Refusal(shared::NOT_REWIRABLE, {what});
  }
}

Guards Guards::current()
{
  Guards all;
  std::lock_guard<std::mutex> lock(handed().state_lock);
  all.by_manager_ = handed().by_manager;
  return all;
}

void Guards::handOver(const std::string& manager, const dyknow_msgs::Guards& guards)
{
  std::lock_guard<std::mutex> lock(handed().state_lock);
  handed().by_manager[manager] = guards;
}

std::string Guards::permitted(const std::string& topic, const std::string& owner)
{
  static const bool is_spawned = std::getenv(SPAWNED) != nullptr;
  if (topic.empty() || (owner == ros::this_node::getName() && !is_spawned))
  {
    return topic;
  }
  try
  {
    current().checkTopic(topic);
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
  for (const auto& [manager, guards] : by_manager_)
  {
    const auto& nodelets = guards.protected_nodelets;
    if (manager != caller && std::find(nodelets.begin(), nodelets.end(), nodelet) != nodelets.end())
    {
      throw Refusal(shared::PROTECTED_FROM_UNLOADING, {nodelet});
    }
  }
}

void Guards::checkCaller(const std::string& caller, const std::string& what) const
{
  const auto own = by_manager_.find(caller);
  const bool is_restorer = own != by_manager_.end() && own->second.read_only;
  if (!is_restorer && std::any_of(by_manager_.begin(), by_manager_.end(),
                                  [](const auto& each) { return each.second.read_only; }))
  {
    throw Refusal(shared::READ_ONLY, {what});
  }
}

void Guards::checkTopic(const std::string& topic) const
{
  std::set<std::string> denied;  // sorted: the text names the first that matches
  for (const auto& each : by_manager_)
  {
    denied.insert(each.second.denied_topics.begin(), each.second.denied_topics.end());
  }
  for (const auto& pattern : denied)
  {
    if (matchesAny(topic, {pattern}))
    {
      throw Refusal(shared::DENIED, {topic, pattern});
    }
  }
  if (std::count(std::begin(shared::SYSTEM_TOPICS), std::end(shared::SYSTEM_TOPICS), topic) > 0)
  {
    return;
  }
  for (const auto& each : by_manager_)
  {
    if (each.second.are_topics_limited && !matchesAny(topic, each.second.allowed_topics))
    {
      throw Refusal(shared::NOT_ALLOWED, {topic});
    }
  }
}

void Guards::checkSizes(const std::vector<std::string>& strings, std::size_t entries) const
{
  std::size_t string_length = shared::STRING_LENGTH;
  std::size_t array_length = shared::ARRAY_LENGTH;
  for (const auto& each : by_manager_)
  {
    string_length = std::min<std::size_t>(string_length, each.second.string_length);
    array_length = std::min<std::size_t>(array_length, each.second.array_length);
  }
  if (entries > array_length)
  {
    throw tooMany("entries in an array", entries, array_length);
  }
  for (const auto& each : strings)
  {
    if (lengthOf(each) > string_length)
    {
      throw tooMany("characters in a string", lengthOf(each), string_length);
    }
  }
}

}  // namespace dyknow
