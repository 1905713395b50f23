// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "self_check.h"

#include <dlfcn.h>
#include <ros/console.h>
#include <ros/this_node.h>

#include "symbols.h"

namespace dyknow
{
namespace
{

thread_local Probe* t_probe = nullptr;

/// Set once, before it is read.
std::vector<std::string>& problems()
{
  static auto& found = *new std::vector<std::string>;  // leaked, see later.cpp
  return found;
}

void checkSymbol(void* hook)
{
  // The address of a hook is that of the first definition, and this function is in our library.
  const std::string ours = libraryOf(reinterpret_cast<void*>(&checkSymbol));
  if (libraryOf(hook) != ours)
  {
    problems().push_back(symbolAt(hook) + " of " + libraryOf(hook) + " is found before that of " + ours);
  }
  else if (definitionBehind(hook) == nullptr)
  {
    problems().push_back("no library defines " + symbolAt(hook));
  }
}

/// Whether libroscpp's own calls arrive at the hooks, which they do not when it is linked with -Bsymbolic.
///
/// Without any ros::NodeHandle: the first one starts roscpp and the last one shuts it down, which are the node's.
void probe()
{
  const Probe probe;
  ros::V_string topics;
  ros::this_node::getAdvertisedTopics(topics);
  if (!probe.isReached())
  {
    problems().push_back("libroscpp does not reach the hook of TopicManager::getAdvertisedTopics");
  }
}

bool check()
{
  for (const auto& hooks : {roscppHooks(), serviceHooks()})
  {
    for (void* hook : hooks)
    {
      checkSymbol(hook);
    }
  }
  for (void* hook : nodeletHooks())
  {
    if (libraryOf(hook) != libraryOf(reinterpret_cast<void*>(&checkSymbol)))
    {
      checkSymbol(hook);  // a node without libnodeletlib has nothing behind these
    }
  }
  if (problems().empty())
  {
    probe();
  }
  for (const auto& each : problems())
  {
    ROS_ERROR("dyknow: %s", each.c_str());
  }
  if (!problems().empty())
  {
    ROS_ERROR("dyknow: ports of this process cannot be re-wired while it runs");
  }
  return problems().empty();
}

}  // namespace

Probe::Probe()
{
  t_probe = this;
}

Probe::~Probe()
{
  t_probe = nullptr;
}

bool Probe::note()
{
  if (t_probe == nullptr)
  {
    return false;
  }
  t_probe->is_reached_ = true;
  return true;
}

bool areHooksReached()
{
  static const bool are_reached = check();
  return are_reached;
}

}  // namespace dyknow
