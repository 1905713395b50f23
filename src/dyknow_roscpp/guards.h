// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Restrictions on changes, those of dyknow/guards.py.
///
/// DyKnow managers hand them over with their polls; those of all add up. A process that a manager starts has its
/// guards in the environment, from the start.
#ifndef DYKNOW_ROSCPP_GUARDS_H
#define DYKNOW_ROSCPP_GUARDS_H

#include <dyknow_msgs/Guards.h>

#include <cstddef>
#include <map>
#include <string>
#include <vector>

namespace dyknow
{

class Guards
{
public:
  /// The guards of this moment.
  static Guards current();

  /// The DyKnow manager that started this process; empty for none.
  static std::string starter();

  /// Lets the nodelets that this thread makes have a loader: the node that requested it.
  class Loading
  {
  public:
    explicit Loading(const std::string& caller);
    ~Loading();
    Loading(const Loading&) = delete;
    Loading& operator=(const Loading&) = delete;
  };

  /// The loader of the nodelet that this thread makes; else the manager that started the process.
  static std::string loader();

  /// Reads `~rewirable`: whether the ports of this process may be connected elsewhere. A value that is neither
  /// true nor false is logged, and stands for false.
  static void readRewirable();

  /// Takes the guards of a manager, in place of those that it handed over before.
  static void handOver(const std::string& manager, const dyknow_msgs::Guards& guards);

  /// Where the node's own code connects a topic at the start: there, or nowhere if guards forbid it, which is
  /// logged. They bind nodelets, and programs that a DyKnow manager starts; what people launch begins where they
  /// say.
  static std::string permitted(const std::string& topic, const std::string& owner);

  /// Refuses to connect ports unless `~rewirable` is true. Raises Refusal.
  static void checkRewirable(const std::string& what);

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
  std::map<std::string, dyknow_msgs::Guards> by_manager_;
};

}  // namespace dyknow

#endif
