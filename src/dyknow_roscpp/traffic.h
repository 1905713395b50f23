// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Counts of what went through one end of a port.
#ifndef DYKNOW_ROSCPP_TRAFFIC_H
#define DYKNOW_ROSCPP_TRAFFIC_H

#include <cstdint>

#include "later.h"

namespace dyknow
{

/// Running counts, those that `dyknow.nodelet.traffic` keeps in Python. The lock of the end guards them.
///
/// What every message touches comes first: it is seldom in the processor's caches any more.
class Traffic
{
public:
  /// A moment of the counts.
  struct Snapshot
  {
    std::uint64_t messages = 0;
    Clock::duration busy{0};
    Clock::duration longest{0};
    std::uint64_t dropped = 0;
    double rate = 0.0;  ///< Hz over the last messages; 0 for less than two, and when none come any more
  };

  /// Counts one message that goes out now, or whose callback begins.
  void count(Clock::time_point now);

  /// The callback of a message that was counted took so long.
  void processed(Clock::duration took);

  /// Counts one message that a full queue refused, or that was published while disconnected.
  void dropped();

  Snapshot snapshot() const;

private:
  /// Number and time of the first message of a stretch; number 0: there was none.
  struct Mark
  {
    std::uint64_t number = 0;
    Clock::time_point time;
  };

  double rate() const;
  /// Whether message `number` came so long before `now` that the stream had stopped.
  bool isPause(std::uint64_t number, Clock::time_point now) const;

  Clock::time_point last_;
  Snapshot counts_;
  Mark begin_;
  Mark before_;
};

}  // namespace dyknow

#endif
