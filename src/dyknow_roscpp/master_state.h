// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file What the ROS master knows of the topics outside this process.
#ifndef DYKNOW_ROSCPP_MASTER_STATE_H
#define DYKNOW_ROSCPP_MASTER_STATE_H

#include <xmlrpcpp/XmlRpcValue.h>

#include <string>

namespace dyknow
{

/// A look at the registrations of all nodes.
class MasterState
{
public:
  /// Asks the master. Raises Refusal if it does not answer: roscpp would hold on for ever in a registration.
  MasterState();

  /// Nodes that subscribe to a topic.
  std::size_t subscribersOf(const std::string& topic) const;

  /// Type of a topic that has a publisher or subscriber, else empty: the master's types outlive them.
  std::string datatypeOf(const std::string& topic) const;

private:
  std::size_t countOf(int side, const std::string& topic) const;

  mutable XmlRpc::XmlRpcValue state_;
};

}  // namespace dyknow

#endif
