// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "self_check.h"

#include <dlfcn.h>
#include <ros/console.h>
#include <ros/node_handle.h>

#include "probe.h"
#include "symbols.h"

namespace dyknow
{
namespace
{

thread_local Probe* t_probe = nullptr;

/// Set once, before anybody reads it.
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

/// Whether libroscpp's own call arrives at the hook, which it does not when it is linked with -Bsymbolic.
template <class Call>
void probe(const char* what, Call call)
{
  const Probe probe;
  try
  {
    call();
  }
  catch (const ros::Exception&)  // raised by libroscpp, as the options are empty: nothing is registered
  {
  }
  if (!probe.isReached())
  {
    problems().push_back(std::string("libroscpp does not reach the hook of TopicManager::") + what);
  }
}

bool check()
{
  for (void* hook : roscppHooks())
  {
    checkSymbol(hook);
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
    ros::NodeHandle handle;
    probe("subscribe",
          [&handle]
          {
            ros::SubscribeOptions options;
            options.topic = "/dyknow_probe";
            handle.subscribe(options);
          });
    probe("advertise",
          [&handle]
          {
            ros::AdvertiseOptions options;
            options.topic = "/dyknow_probe";
            handle.advertise(options);
          });
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
  if (t_probe != nullptr)
  {
    return false;  // in the check itself: pass the call on
  }
  static const bool are_reached = check();
  return are_reached;
}

std::vector<std::string> selfCheckProblems()
{
  return problems();
}

}  // namespace dyknow
