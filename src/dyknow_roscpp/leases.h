// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Which nodelets of this process may publish on topics of claims: the rules of dyknow/nodelet/leases.py.
#ifndef DYKNOW_ROSCPP_LEASES_H
#define DYKNOW_ROSCPP_LEASES_H

#include <atomic>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <utility>

namespace dyknow
{

/// The leases of this process, one for each DyKnow manager. Every method is safe from any thread.
class Leases
{
public:
  using Producers = std::map<std::string, std::string>;  ///< by topic of a claim, its publisher

  static Leases& instance();

  /// Our clock (s), which runs on while the process is stopped, and while the machine is suspended.
  static double clock();

  /// Takes a renewal; see Poll.srv.
  void renew(const std::string& manager, const std::string& uri, double confirmed, double duration,
             const Producers& producers);

  /// Whether a nodelet may publish on a topic now.
  bool mayPublish(const std::string& nodelet, const std::string& topic) const
  {
    return !has_any_.load(std::memory_order_relaxed) || mayPublishThere(nodelet, topic);
  }

private:
  struct Lease
  {
    std::string uri;
    double until = 0.0;
    double probed_from = 0.0;
    Producers producers;
    std::set<std::pair<std::string, std::string>> fenced;  ///< nodelets, each with a topic, that were replaced
  };

  Leases() = default;
  bool mayPublishThere(const std::string& nodelet, const std::string& topic) const;
  /// Extends the leases that are about to run out, where no manager is at work; on a thread of its own.
  void watch();

  std::atomic<bool> has_any_{false};
  mutable std::mutex state_lock_;
  std::map<std::string, Lease> leases_;
  bool is_watched_ = false;
};

}  // namespace dyknow

#endif
