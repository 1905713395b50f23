// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The activity of a thread, for hooks that are reached from there.
#ifndef DYKNOW_ROSCPP_SETTING_H
#define DYKNOW_ROSCPP_SETTING_H

#include <utility>

namespace dyknow
{

/// Sets a variable of this thread while it lives.
template <class Value>
class Setting
{
public:
  Setting(Value& variable, Value value) : variable_(variable), before_(std::exchange(variable, value)) {}
  ~Setting() { variable_ = before_; }
  Setting(const Setting&) = delete;
  Setting& operator=(const Setting&) = delete;

private:
  Value& variable_;
  const Value before_;
};

}  // namespace dyknow

#endif
