// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The proxy of the paper's figure 2: ports of one node or nodelet, and where they are connected.
#ifndef DYKNOW_ROSCPP_NODELET_PROXY_H
#define DYKNOW_ROSCPP_NODELET_PROXY_H

#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "port.h"

namespace dyknow
{

class Guards;
class MasterState;

/// A change is checked as a whole, then applied as a whole. Every method is safe from any thread.
///
/// Locks: `turn_lock_` is held over a reconfiguration, which waits for the ROS master at most 5 s, for peers
/// at most 0.5 s, and for no callback; `state_lock_` guards the tables of ports and remappings. Neither lock
/// is held while an end is opened or closed.
class NodeletProxy
{
public:
  /// A port and its name at this moment.
  struct NamedPort
  {
    std::string name;
    std::shared_ptr<Port> port;
  };
  using Config = std::vector<std::pair<std::string, std::string>>;

  /// @param remappings of the load request or the process, global to global. A source of them may be the topic
  ///        of a port to come: a lazy nodelet subscribes once it has a subscriber
  /// @param on_change called after every change of a port, on the thread that made it
  NodeletProxy(std::string name, std::map<std::string, std::string> remappings,
               std::function<void(const std::string&)> on_change);

  const std::string name;
  const Clock::time_point started = Clock::now();
  std::string loader;                   ///< node that had it loaded; set before it is offered
  std::atomic<bool> is_offered{false};  ///< its services are
  const std::shared_ptr<ReconfigureListener> listener = std::make_shared<ReconfigureListener>();
  std::mutex noted_lock;
  std::map<std::string, std::string> noted;  ///< labels by resolved name, of port_names.h; under its lock

  std::map<std::string, std::string> remappings() const;
  void add(const std::map<std::string, std::string>& remappings);

  /// The port of a name; the first call makes it.
  ///
  /// @param topic where remappings put it; below `NODELET/disconnected/`: it starts disconnected
  std::shared_ptr<Port> declare(const PortName& port_name, Direction direction, const std::string& topic);

  /// The ports, in the order of their declaration.
  std::vector<NamedPort> ports() const;

  /// How often the connections were changed.
  std::uint32_t reconfigurations() const;

  /// Connects ports to topics, all or none; an empty topic disconnects. Raises Refusal; nothing is changed
  /// then.
  ///
  /// @param caller name of the node that asks for it
  void setConfig(const Config& config, const std::string& caller);

  /// The nodelet is unloaded: no more changes.
  void close();

private:
  struct Change
  {
    std::shared_ptr<Port> port;
    std::string topic;
  };

  std::vector<Change> checked(const Config& config, const Guards& guards, const MasterState& master) const;
  std::vector<std::shared_ptr<Port>> find(const std::string& text, const std::vector<NamedPort>& ports) const;
  std::shared_ptr<Port> portToCome(const std::string& origin, const std::vector<NamedPort>& ports) const;
  std::string topicAtStart(const std::string& remapped) const;
  void checkType(const NamedPort& port, const std::string& topic, const MasterState& master,
                 std::map<std::string, std::string>& types) const;
  void apply(std::vector<Change> changes);
  void setTopicsLocked(std::vector<Change>& changes);
  void followPorts(const std::vector<Change>& changes);

  const std::function<void(const std::string&)> on_change_;
  std::timed_mutex turn_lock_;
  mutable std::mutex state_lock_;
  std::map<std::string, std::string> remappings_;
  std::vector<std::shared_ptr<Port>> ports_;
  std::uint32_t reconfigurations_ = 0;
  bool is_closed_ = false;
};

}  // namespace dyknow

#endif
