// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Why a change is refused, in the words of the Python proxy (dyknow/errors.py).
#ifndef DYKNOW_ROSCPP_PROBLEMS_H
#define DYKNOW_ROSCPP_PROBLEMS_H

#include <stdexcept>
#include <string>
#include <vector>

#include "dyknow_shared.h"

namespace dyknow
{

/// A change was refused; nothing was changed.
class Refusal : public std::runtime_error
{
public:
  /// @param text where `{0}`, `{1}` … stand for the arguments, if there are some
  explicit Refusal(const std::string& text, const std::vector<std::string>& arguments = {});
};

std::string joined(const std::vector<std::string>& texts, const std::string& separator);

/// Writes `; did you mean a or b?` for the end of an error, as dyknow/similar.py; empty if no name is similar.
std::string didYouMean(const std::string& name, const std::vector<std::string>& known);

}  // namespace dyknow

#endif
