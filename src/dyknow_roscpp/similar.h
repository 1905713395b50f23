// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Suggestions for a name that is not known, those of dyknow/similar.py.
#ifndef DYKNOW_ROSCPP_SIMILAR_H
#define DYKNOW_ROSCPP_SIMILAR_H

#include <string>
#include <vector>

namespace dyknow
{

/// Writes `; did you mean a or b?` for the end of an error; empty if no name is similar.
std::string didYouMean(const std::string& name, const std::vector<std::string>& known);

}  // namespace dyknow

#endif
