// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "master_state.h"

#include <ros/this_node.h>

#include <algorithm>

#include "problems.h"
#include "question.h"

namespace dyknow
{
namespace
{

constexpr int PUBLISHERS = 0;
constexpr int SUBSCRIBERS = 1;
constexpr std::chrono::milliseconds NODE_PATIENCE(200);

/// The type of a topic in a list of pairs; empty if it is not there, or matches any.
std::string typeIn(XmlRpc::XmlRpcValue types, const std::string& topic)
{
  for (int i = 0; types.valid() && i < types.size(); ++i)
  {
    if (static_cast<std::string>(types[i][0]) == topic)
    {
      const std::string found = types[i][1];
      return found == "*" ? "" : found;
    }
  }
  return "";
}

}  // namespace

std::string MasterState::datatypeOf(const std::string& topic) const
{
  if (!nodesOn(PUBLISHERS, topic).empty())
  {
    return typeIn(askMaster("getTopicTypes", "", deadline_), topic);
  }
  for (const auto& node : nodesOn(SUBSCRIBERS, topic))
  {
    const std::string found = subscribedType(node, topic);
    if (!found.empty())
    {
      return found;
    }
  }
  return "";
}

std::vector<std::string> MasterState::nodesOn(int side, const std::string& topic) const
{
  if (!state_.valid())
  {
    state_ = askMaster("getSystemState", "", deadline_);
  }
  std::vector<std::string> nodes;
  auto& topics = state_[side];
  for (int i = 0; i < topics.size(); ++i)
  {
    if (static_cast<std::string>(topics[i][0]) == topic)
    {
      for (int j = 0; j < topics[i][1].size(); ++j)
      {
        nodes.push_back(topics[i][1][j]);
      }
    }
  }
  return nodes;
}

std::string MasterState::subscribedType(const std::string& node, const std::string& topic) const
{
  if (node == ros::this_node::getName())
  {
    return "";  // the ports of this process report their own types
  }
  auto uri = askMaster("lookupNode", node, deadline_);
  if (!uri.valid())
  {
    return "";
  }
  try
  {
    const auto deadline = std::min(deadline_, Clock::now() + NODE_PATIENCE);
    return typeIn(ask(uri, "getSubscriptions", "", deadline), topic);
  }
  catch (const Refusal&)
  {
    return "";  // a node that does not answer says nothing of the topic
  }
}

}  // namespace dyknow
