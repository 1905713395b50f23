// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Why a change is refused, in the words that the Python proxy uses (dyknow/errors.py).
#ifndef DYKNOW_ROSCPP_PROBLEMS_H
#define DYKNOW_ROSCPP_PROBLEMS_H

#include <stdexcept>
#include <string>
#include <vector>

namespace dyknow
{

/// A change was refused; nothing was changed.
class Refusal : public std::runtime_error
{
public:
  using std::runtime_error::runtime_error;
};

Refusal invalidName(const std::string& name, const std::string& what);
Refusal typeMismatch(const std::string& topic, const std::string& wanted, const std::string& present);
Refusal denied(const std::string& what, const std::string& why);
Refusal protectedFromUnloading(const std::string& nodelet);
Refusal limitExceeded(const std::string& what, std::size_t count, std::size_t limit);
Refusal unknownPort(const std::string& port, std::vector<std::string> known);
Refusal duplicatePort(const std::string& port);
Refusal unloadedMeanwhile(const std::string& nodelet);

/// All that is wrong with one configuration.
Refusal invalidConfiguration(const std::string& nodelet, const std::vector<std::string>& problems);

}  // namespace dyknow

#endif
