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

double seconds(Clock::duration duration)
{
  return std::chrono::duration<double>(duration).count();
}

}  // namespace

void Traffic::sent()
{
  count(Clock::now());
}

void Traffic::received(Clock::time_point now)
{
  count(now);
}

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
  last_ = now;
  if (number % STRETCH == 1)
  {
    before_ = number > 1 ? begin_ : Mark{1, now};
    begin_ = Mark{number, now};
  }
}

double Traffic::rate() const
{
  if (before_.number == 0 || counts_.messages <= before_.number)
  {
    return 0.0;
  }
  const double intervals = static_cast<double>(counts_.messages - before_.number);
  double span = seconds(last_ - before_.time);
  const double silence = seconds(Clock::now() - last_);
  // Until a message is overdue the rate is that of the stretch; then the silence counts with it.
  if (silence > 2 * span / intervals)
  {
    span += silence;
  }
  return span > 0 ? intervals / span : 0.0;
}

}  // namespace dyknow
