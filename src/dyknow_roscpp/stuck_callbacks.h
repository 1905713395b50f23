// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Callbacks of nodelets that do not return, which DyKnow managers report.
#ifndef DYKNOW_ROSCPP_STUCK_CALLBACKS_H
#define DYKNOW_ROSCPP_STUCK_CALLBACKS_H

#include <string>

namespace dyknow
{

/// Looks for them from now on, and announces their nodelets; the parameter `~stuck_after` says after how long.
void watchCallbacks();

/// Describes a nodelet's callback that does not return, as dyknow/nodelet/loading/leftovers.py; empty if it has none.
std::string stuckCallback(const std::string& nodelet);

}  // namespace dyknow

#endif
