// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "stuck_callbacks.h"

#include <ros/param.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <mutex>

#include "later.h"
#include "process_services.h"
#include "registry.h"

namespace dyknow
{
namespace
{

constexpr double STUCK_AFTER = 10.0;  // s
/// What the clock can count, and what leaves time for other work.
constexpr double LEAST = 0.01, MOST = 1e6;  // s
/// Looks in that time: a callback is as old as the first look that saw it.
constexpr int LOOKS = 4;

/// The faults of nodelets, by nodelet.
struct Details
{
  std::mutex state_lock;
  std::map<std::string, std::string> all;
};

Details& details()
{
  static auto& details = *new Details;  // leaked, see later.cpp
  return details;
}

void look(std::chrono::duration<double> after)
{
  const auto now = Clock::now();
  std::map<std::string, std::string> found;
  for (auto* work : RunningQueue::all())
  {
    if (const std::uint64_t number = work->number; number != work->seen)
    {
      work->seen = number;
      work->since = now;
      work->due = after;
    }
    const std::chrono::duration<double> age = now - work->since;
    const std::string nodelet = Registry::instance().nodeletOf(work->queue);
    if (nodelet.empty() || age < after)
    {
      continue;
    }
    found[nodelet] = "a callback has been running for " + std::to_string(std::lround(age.count())) + " s";
    if (age >= work->due)
    {
      work->due = 2 * age;
      announceChange(nodelet);
    }
  }
  {
    std::lock_guard<std::mutex> lock(details().state_lock);
    details().all.swap(found);
  }
  for (const auto& each : found)
  {
    if (stuckCallback(each.first).empty())
    {
      announceChange(each.first);  // it has returned
    }
  }
  later([after] { look(after); }, now + std::chrono::duration_cast<Clock::duration>(after / LOOKS));
}

}  // namespace

void watchCallbacks()
{
  static std::once_flag is_begun;
  std::call_once(is_begun,
                 []
                 {
                   const double after = ros::param::param("~stuck_after", STUCK_AFTER);
                   look(std::chrono::duration<double>(after > 0 ? std::clamp(after, LEAST, MOST)
                                                                : STUCK_AFTER));
                 });
}

std::string stuckCallback(const std::string& nodelet)
{
  std::lock_guard<std::mutex> lock(details().state_lock);
  const auto found = details().all.find(nodelet);
  return found == details().all.end() ? "" : found->second;
}

}  // namespace dyknow
