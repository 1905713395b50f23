// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "traffic.h"

#include <algorithm>

namespace dyknow
{
namespace
{

/// A rate is taken over the last one to two stretches of so many messages, so that it follows.
constexpr std::uint64_t STRETCH = 32;
/// Shorter silences are none; a longer one is if it is also longer than some messages took.
constexpr double PAUSE = 2.0;
constexpr double OVERDUE = 3;

double seconds(Clock::duration duration)
{
  return std::chrono::duration<double>(duration).count();
}

}  // namespace

void Traffic::processed(Clock::duration took)
{
  counts_.busy += took;
  counts_.longest = std::max(counts_.longest, took);
}

void Traffic::dropped()
{
  ++counts_.dropped;
}

Traffic::Snapshot Traffic::snapshot() const
{
  Snapshot found = counts_;
  found.rate = rate();
  return found;
}

void Traffic::count(Clock::time_point now)
{
  const std::uint64_t number = ++counts_.messages;
  if (number == 1 || isPause(number - 1, now))
  {
    before_ = begin_ = Mark{number, now};
  }
  else if (number % STRETCH == 1)
  {
    before_ = begin_;
    begin_ = Mark{number, now};
  }
  last_ = now;
}

bool Traffic::isPause(std::uint64_t number, Clock::time_point now) const
{
  const double silence = seconds(now - last_);
  return silence > PAUSE &&
         silence * static_cast<double>(number - before_.number) > OVERDUE * seconds(last_ - before_.time);
}

double Traffic::rate() const
{
  const Clock::time_point now = Clock::now();
  if (before_.number == 0 || counts_.messages <= before_.number || isPause(counts_.messages, now))
  {
    return 0.0;
  }
  const double intervals = static_cast<double>(counts_.messages - before_.number);
  double span = seconds(last_ - before_.time);
  const double silence = seconds(now - last_);
  // Until a message is overdue the rate is that of the stretch; then the silence counts with it.
  if (silence > 2 * span / intervals)
  {
    span += silence;
  }
  return span > 0 ? intervals / span : 0.0;
}

}  // namespace dyknow
