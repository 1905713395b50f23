// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Work that is done later, on a thread of its own.
#ifndef DYKNOW_ROSCPP_LATER_H
#define DYKNOW_ROSCPP_LATER_H

#include <functional>

#include "traffic.h"

namespace dyknow
{

/// Runs `work` on the thread for later work when it is due; earlier work goes first.
///
/// The work may take locks and talk to the master, but never wait for a callback. It is dropped when ROS
/// shuts down.
void later(std::function<void()> work, Clock::time_point due = Clock::now());

}  // namespace dyknow

#endif
