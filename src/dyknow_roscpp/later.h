// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Time: waits until a deadline, and work that is done later, on a thread of its own.
#ifndef DYKNOW_ROSCPP_LATER_H
#define DYKNOW_ROSCPP_LATER_H

#include <chrono>
#include <functional>

namespace dyknow
{

using Clock = std::chrono::steady_clock;

/// The argument of the standard library's waits for a deadline.
///
/// The thread sanitizer of this compiler does not know the functions of the C library that a steady clock leads
/// to (pthread_mutex_clocklock, pthread_cond_clockwait), and takes the lock for a free one. Where it
/// is used, the clock that can be set has to do.
inline auto forWaiting(Clock::time_point deadline)
{
#ifdef __SANITIZE_THREAD__
  return std::chrono::system_clock::now() + (deadline - Clock::now());
#else
  return deadline;
#endif
}

/// Runs `work` on the thread for later work when it is due; earlier work goes first.
///
/// The work may take locks and talk to the master, but never wait for a callback. It is dropped when ROS
/// shuts down.
void later(std::function<void()> work, Clock::time_point due = Clock::now());

/// Drops that work from now on, and waits for what is being done, for a second at most.
void endLaterWork();

}  // namespace dyknow

#endif
