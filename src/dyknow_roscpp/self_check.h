// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Whether the library stands in front of libroscpp.
#ifndef DYKNOW_ROSCPP_SELF_CHECK_H
#define DYKNOW_ROSCPP_SELF_CHECK_H

#include <vector>

namespace dyknow
{

/// Looks whether each hook is reached; needs an initialised node. Where something is wrong, all hooks do
/// nothing but pass calls on, and the log says why.
///
/// The first call decides for the life of the process.
bool areHooksReached();

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

/// Addresses of all hooks of libroscpp's functions; those of services have a file of their own.
std::vector<void*> roscppHooks();
std::vector<void*> serviceHooks();

/// Addresses of all hooks of libnodeletlib's functions.
std::vector<void*> nodeletHooks();

}  // namespace dyknow

#endif
