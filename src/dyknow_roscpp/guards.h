// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Restrictions on changes, those of dyknow/guards.py.
///
/// DyKnow managers hand them to a process as its private parameters `~guards/KEY`, one for each manager;
/// those of all add up.
#ifndef DYKNOW_ROSCPP_GUARDS_H
#define DYKNOW_ROSCPP_GUARDS_H

#include <cstddef>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "dyknow_shared.h"
#include "later.h"

namespace dyknow
{

class Guards
{
public:
  /// Asks the parameter server for the guards of this moment: roscpp's cache may not have heard of them yet.
  /// Raises Refusal if it does not answer by the deadline.
  static Guards current(Clock::time_point deadline);

  /// Where the node's own code connects a topic at the start: there, or nowhere if guards forbid it, which is
  /// logged. They bind nodelets, and programs that a DyKnow manager starts; what people launch begins where they
  /// say. If the parameter server does not answer, the guards are those of the last time.
  static std::string permitted(const std::string& topic, const std::string& owner);

  /// Refuses a change in read-only mode, unless a manager makes it that is read-only itself: it refuses what
  /// users ask of it, and still brings back nodelets that died. Raises Refusal.
  void checkCaller(const std::string& caller, const std::string& what) const;

  /// Refuses to unload a nodelet that another DyKnow manager than the caller protects. Raises Refusal.
  void checkProtection(const std::string& caller, const std::string& nodelet) const;

  /// Refuses a topic of the deny list, and one that is not on an allow list. Raises Refusal.
  void checkTopic(const std::string& topic) const;

  /// Refuses strings and arrays beyond the limits. Raises Refusal.
  void checkSizes(const std::vector<std::string>& strings, std::size_t entries) const;

private:
  std::set<std::string> denied_topics_;
  std::vector<std::vector<std::string>> allowed_topics_;          ///< of each manager that has some
  std::map<std::string, std::set<std::string>> protected_;        ///< nodelets by the key of their manager
  std::set<std::string> read_only_owners_;  ///< keys of managers
  std::size_t string_length_ = shared::STRING_LENGTH;
  std::size_t array_length_ = shared::ARRAY_LENGTH;
};

}  // namespace dyknow

#endif
