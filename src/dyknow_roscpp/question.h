// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Questions to the ROS master and to nodes, with a deadline.
#ifndef DYKNOW_ROSCPP_QUESTION_H
#define DYKNOW_ROSCPP_QUESTION_H

#include <xmlrpcpp/XmlRpcValue.h>

#include <chrono>
#include <string>

#include "traffic.h"

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

}  // namespace dyknow

#endif
