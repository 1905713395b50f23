// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Questions to the ROS master and to nodes, with a deadline, and the types of topics.
#ifndef DYKNOW_ROSCPP_MASTER_H
#define DYKNOW_ROSCPP_MASTER_H

#include <xmlrpcpp/XmlRpcValue.h>

#include <chrono>
#include <string>
#include <vector>

#include "later.h"

namespace dyknow
{

/// How long an operation waits for the ROS master: on a busy machine an answer may take more than a second.
constexpr std::chrono::milliseconds MASTER_PATIENCE(5000);

/// Calls a function of the API of the ROS master or of a node: roscpp waits for ever for one that hangs.
///
/// Returns its value; one that is not valid if the answer is an error, as for a name that is not known.
/// Raises Refusal if there is no answer by the deadline.
///
/// @param argument follows the name of this node; empty: no argument
XmlRpc::XmlRpcValue ask(const std::string& uri, const std::string& question, const std::string& argument,
                        Clock::time_point deadline);

/// Same, of the master.
XmlRpc::XmlRpcValue askMaster(const std::string& question, const std::string& argument,
                              Clock::time_point deadline);

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

  /// Raises Refusal unless the master has answered, or does so now: otherwise roscpp would hold on for ever in a
  /// registration.
  void requireAnswer() const;

private:
  std::string typeOn(const std::string& topic) const;
  std::vector<std::string> nodesOn(int side, const std::string& topic) const;
  std::string subscribedType(const std::string& node, const std::string& topic) const;

  const Clock::time_point deadline_;
  mutable XmlRpc::XmlRpcValue state_;  ///< not valid before it was requested
};

/// Whether two names stand for one type: their checksums are equal, as in roscpp's own comparison. Where one
/// cannot be had, because the type is not installed, the names are compared.
bool isSameType(const std::string& one, const std::string& other);

}  // namespace dyknow

#endif
