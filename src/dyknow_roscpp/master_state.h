// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The ROS master's knowledge of the topics outside this process.
#ifndef DYKNOW_ROSCPP_MASTER_STATE_H
#define DYKNOW_ROSCPP_MASTER_STATE_H

#include <xmlrpcpp/XmlRpcValue.h>

#include <string>
#include <vector>

#include "traffic.h"

namespace dyknow
{

/// A look at the registrations of all nodes, once it is needed: it takes the longer the more there are.
///
/// Every method raises Refusal if the master does not answer.
class MasterState
{
public:
  /// @param deadline of its questions
  explicit MasterState(Clock::time_point deadline) : deadline_(deadline) {}

  /// Type of a topic that has a publisher or subscriber, else empty.
  ///
  /// The master's types outlive the publishers that they come from, so they count only while there is a
  /// publisher; without one the subscribers are queried.
  std::string datatypeOf(const std::string& topic) const;

private:
  std::vector<std::string> nodesOn(int side, const std::string& topic) const;
  std::string subscribedType(const std::string& node, const std::string& topic) const;

  const Clock::time_point deadline_;
  mutable XmlRpc::XmlRpcValue state_;  ///< not valid before it was requested
};

}  // namespace dyknow

#endif
