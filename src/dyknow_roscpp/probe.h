// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Calls that only try whether the hooks are reached.
#ifndef DYKNOW_ROSCPP_PROBE_H
#define DYKNOW_ROSCPP_PROBE_H

#include <vector>

namespace dyknow
{

/// While it lives, TopicManager::getAdvertisedTopics does nothing in this thread but note that it was reached.
class Probe
{
public:
  Probe();
  ~Probe();
  Probe(const Probe&) = delete;
  Probe& operator=(const Probe&) = delete;

  bool isReached() const { return is_reached_; }

  /// Called by the hook: whether the call is a probe.
  static bool note();

private:
  bool is_reached_ = false;
};

/// Addresses of all hooks of libroscpp's functions.
std::vector<void*> roscppHooks();

/// Addresses of all hooks of libnodeletlib's functions.
std::vector<void*> nodeletHooks();

}  // namespace dyknow

#endif
