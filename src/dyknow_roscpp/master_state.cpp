// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "master_state.h"

#include <ros/master.h>
#include <ros/this_node.h>

#include "problems.h"

namespace dyknow
{
namespace
{

constexpr int PUBLISHERS = 0;
constexpr int SUBSCRIBERS = 1;

XmlRpc::XmlRpcValue ask(const std::string& question)
{
  XmlRpc::XmlRpcValue request;
  XmlRpc::XmlRpcValue response;
  XmlRpc::XmlRpcValue payload;
  request[0] = ros::this_node::getName();
  if (!ros::master::execute(question, request, response, payload, false))
  {
    throw Refusal("the ROS master at " + ros::master::getURI() + " does not answer");
  }
  return payload;
}

}  // namespace

MasterState::MasterState() : state_(ask("getSystemState")) {}

std::size_t MasterState::subscribersOf(const std::string& topic) const
{
  return countOf(SUBSCRIBERS, topic);
}

std::string MasterState::datatypeOf(const std::string& topic) const
{
  if (countOf(PUBLISHERS, topic) == 0 && countOf(SUBSCRIBERS, topic) == 0)
  {
    return "";
  }
  auto types = ask("getTopicTypes");
  for (int i = 0; i < types.size(); ++i)
  {
    if (static_cast<std::string>(types[i][0]) == topic)
    {
      const std::string found = types[i][1];
      return found == "*" ? "" : found;
    }
  }
  return "";
}

std::size_t MasterState::countOf(int side, const std::string& topic) const
{
  auto& topics = state_[side];
  for (int i = 0; i < topics.size(); ++i)
  {
    if (static_cast<std::string>(topics[i][0]) == topic)
    {
      return topics[i][1].size();
    }
  }
  return 0;
}

}  // namespace dyknow
