// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The owners of handles, and the objects behind them.
#ifndef DYKNOW_ROSCPP_REGISTRY_H
#define DYKNOW_ROSCPP_REGISTRY_H

#include <boost/container/flat_map.hpp>
#include <ros/callback_queue_interface.h>
#include <ros/node_handle.h>

#include <atomic>
#include <map>
#include <memory>
#include <shared_mutex>
#include <string>
#include <vector>

#include "later.h"
#include "nodelet_proxy.h"
#include "port_publication.h"
#include "port_subscription.h"

namespace dyknow
{

/// The tables of this process. Every method is safe from any thread.
///
/// The name of a topic does not distinguish two nodelets on one topic. So the hooks put a key of its own into
/// the options of each handle, which roscpp then passes in every later call in place of the topic.
///
/// A handle belongs to the nodelet whose callback queue it uses; if it uses none, to the nodelet that this
/// thread runs (`RunningQueue`); else to the node. A tracked object would be no key: many handles have none.
class Registry
{
public:
  static Registry& instance();

  // Owners

  /// A nodelet begins; its handles use these queues. A standalone one has the name of its node, and the node's
  /// proxy: handles of its constructor are among its ports.
  std::shared_ptr<NodeletProxy> enter(const std::string& nodelet,
                                      const std::map<std::string, std::string>& remappings,
                                      const std::vector<ros::CallbackQueueInterface*>& queues);

  /// The nodelet of a queue ends: returns its proxy, which is closed; null if there is none (any more). Handles that
  /// it makes from now on, in a callback that still runs, are nobody's ports.
  std::shared_ptr<NodeletProxy> leave(const ros::CallbackQueueInterface* queue);

  /// The nodelet of a queue is destroyed.
  void forget(const ros::CallbackQueueInterface* queue);

  /// The name of the nodelet of a queue; empty if there is none (any more).
  std::string nodeletOf(const ros::CallbackQueueInterface* queue) const;

  std::shared_ptr<NodeletProxy> ownerOf(const ros::NodeHandle& handle,
                                        const ros::CallbackQueueInterface* queue);
  /// The proxy of the node itself.
  std::shared_ptr<NodeletProxy> node();
  std::vector<std::shared_ptr<NodeletProxy>> owners() const;

  /// Type of a topic that a port of this process is connected to; empty if none is.
  std::string datatypeOf(const std::string& topic) const;

  // Handles

  std::string makeKey(const std::string& topic);
  static bool isKey(const std::string& text);
  /// The topic that a key was made for; of other texts, the text itself.
  static std::string topicOf(const std::string& key);
  void add(const std::string& key, std::shared_ptr<PortSubscription> subscription);
  void add(const std::string& key, std::shared_ptr<PortPublication> publication);
  std::shared_ptr<PortSubscription> subscription(const std::string& key) const;
  std::shared_ptr<PortPublication> publication(const std::string& key) const;
  void remove(const std::string& key);

private:
  Registry() = default;

  bool isPresentLocked(const std::shared_ptr<NodeletProxy>& proxy) const;

  mutable std::shared_mutex state_lock_;
  std::map<const ros::CallbackQueueInterface*, std::shared_ptr<NodeletProxy>> queues_;
  std::map<std::string, std::shared_ptr<NodeletProxy>> owners_;
  // By the number that ends the key: every message is looked up, and these arrays are short.
  boost::container::flat_map<std::uint64_t, std::shared_ptr<PortSubscription>> subscriptions_;
  boost::container::flat_map<std::uint64_t, std::shared_ptr<PortPublication>> publications_;
  std::uint64_t last_number_ = 0;
};

/// Says, while it lives, that this thread works for the nodelet of a queue.
class RunningQueue
{
public:
  explicit RunningQueue(const ros::CallbackQueueInterface* queue);
  ~RunningQueue();
  RunningQueue(const RunningQueue&) = delete;
  RunningQueue& operator=(const RunningQueue&) = delete;

  static const ros::CallbackQueueInterface* current();

  /// The work of a thread.
  struct Work
  {
    std::atomic<const ros::CallbackQueueInterface*> queue{nullptr};
    std::atomic<std::uint64_t> number{0};  ///< of the callback
    // Of the one thread that looks at it.
    std::uint64_t seen = 0;
    Clock::time_point since;
    std::chrono::duration<double> due;
  };

  /// That of all threads which have worked for a nodelet.
  static std::vector<Work*> all();

private:
  const ros::CallbackQueueInterface* const before_;
};

}  // namespace dyknow

#endif
