// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Whether the library stands in front of libroscpp.
#ifndef DYKNOW_ROSCPP_SELF_CHECK_H
#define DYKNOW_ROSCPP_SELF_CHECK_H

#include <string>
#include <vector>

namespace dyknow
{

/// Looks whether each hook is reached; needs an initialised node. Where something is wrong, all hooks do
/// nothing but pass calls on, and the log says why.
///
/// The first call decides for the life of the process.
bool areHooksReached();

}  // namespace dyknow

#endif
