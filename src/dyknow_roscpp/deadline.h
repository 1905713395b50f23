// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Waiting until a deadline.
#ifndef DYKNOW_ROSCPP_DEADLINE_H
#define DYKNOW_ROSCPP_DEADLINE_H

#include <chrono>

#include "traffic.h"

namespace dyknow
{

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

}  // namespace dyknow

#endif
