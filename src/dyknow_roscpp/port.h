// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Ports: the state objects of a node's or nodelet's topics.
#ifndef DYKNOW_ROSCPP_PORT_H
#define DYKNOW_ROSCPP_PORT_H

#include <atomic>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "reconfiguration.h"
#include "traffic.h"

namespace dyknow
{

enum class Direction
{
  IN,
  OUT
};

/// Where the out-ports of a change are, which its in-ports must not hear there.
struct OutTopics
{
  std::set<std::string> left;  ///< until the change
  std::set<std::string> come;  ///< from the change on
};

/// The object behind a handle of roscpp (ros::Publisher, ros::Subscriber), which moves with its port.
///
/// A move is prepared, then either committed or cancelled. One thread moves an end at a time; its node may
/// close it meanwhile, and it then does nothing any more.
class End
{
public:
  virtual ~End() = default;

  /// Registers on a topic (empty: on none) beside the present one. Raises an exception if that fails.
  virtual void prepare(const std::string& topic, Clock::time_point deadline, const OutTopics& outs) = 0;

  /// Whether the peers that the master knows are connected to the prepared end. The old topic of a
  /// subscription is live until the new one is.
  virtual bool isReady() const { return true; }

  /// An in-port closes its connection to a topic that out-ports of the change come to; before they are committed.
  virtual void makeWay() {}

  /// @param announcement made when the node may be notified: at the switch, before the first new message
  ///   is queued; null: the node is not to be notified
  /// @return whether it is, or will be made
  virtual bool commit(const AnnouncementPtr& announcement) = 0;
  virtual void cancel() = 0;

  /// The topic that it is connected to; empty: none. Of an end that is not open, an empty text as well.
  virtual std::string topic() const = 0;

  /// Whether its node holds it.
  virtual bool isOpen() const = 0;

  /// What went through it.
  virtual Traffic traffic() const = 0;
};

/// How a port is called.
struct PortName
{
  std::string label;   ///< without the suffix that distinguishes the directions
  std::string origin;  ///< global name of the topic before any remapping
  std::string image;   ///< label of the image that image_transport put it beside or below; empty: none
};

/// Where image_transport puts the topic of a port when the topic of its image (empty: none) is this one.
std::string topicBeside(const PortName& name, const std::string& image);

/// A port lives as long as its nodelet, while handles on it come and go (lazy nodelets unsubscribe while
/// they have no subscribers): a handle that is made later has the same connection. Every method is safe from
/// any thread.
class Port
{
public:
  /// @param resolved empty: it is to come, no handle has been made on it yet
  Port(std::string owner, PortName name, Direction direction, std::string topic, std::string resolved = "");

  const std::string owner;  ///< name of the node or nodelet
  const PortName name;
  const Direction direction;
  const std::string resolved;  ///< what roscpp made of its name, and wrote into the options of its handle
  std::atomic<bool> is_watched{false};  ///< an out-port whose code is notified of its subscribers
  /// An out-port keeps a message for subscribers that connect later.
  std::atomic<bool> latched{false};

  std::string topic() const;
  void setTopic(const std::string& topic);
  std::string datatype() const;

  /// Lets an end share the port; returns its counts, which go on where those of an end that has left stopped.
  Traffic join(const std::shared_ptr<End>& end, const std::string& datatype);
  void leave(const End* end, const Traffic& traffic);
  std::vector<std::shared_ptr<End>> ends() const;

  /// What went through all that share the port.
  Traffic::Snapshot statistics() const;

private:
  struct Share
  {
    const End* key;
    std::weak_ptr<End> end;
    Traffic traffic;  ///< of the end that has left
  };

  mutable std::mutex state_lock_;
  std::string topic_;
  std::string datatype_;
  std::vector<Share> shares_;
};

}  // namespace dyknow

#endif
