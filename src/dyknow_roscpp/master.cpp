// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "master.h"

#include <ros/master.h>
#include <ros/network.h>
#include <ros/this_node.h>
#include <ros/xmlrpc_manager.h>
#include <xmlrpcpp/XmlRpcClient.h>
#include <xmlrpcpp/XmlRpcException.h>

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <sstream>

#include "problems.h"

namespace dyknow
{
namespace
{

constexpr int PUBLISHERS = 0;
constexpr int SUBSCRIBERS = 1;
constexpr std::chrono::milliseconds NODE_PATIENCE(500);

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

/// Where Debian has the modules of its ROS packages, which no set-up file adds to PYTHONPATH.
constexpr const char* SYSTEM_MODULES = "/usr/lib/python3/dist-packages";

/// The checksum of a type, from the Python module that is generated for every message; else its name.
std::string canonical(const std::string& datatype)
{
  const auto slash = datatype.find('/');
  const auto is_usual = [](unsigned char each) {
    return each == '_' || each == '/' || (each < 128 && std::isalnum(each) != 0);
  };
  if (slash == std::string::npos || slash != datatype.rfind('/') ||
      !std::all_of(datatype.begin(), datatype.end(), is_usual))
  {
    return datatype;
  }
  const std::string path = "/" + std::string(datatype).replace(slash, 1, "/msg/_") + ".py";
  const char* modules = std::getenv("PYTHONPATH");
  std::istringstream folders(std::string(modules == nullptr ? "" : modules) + ":" + SYSTEM_MODULES);
  for (std::string folder; std::getline(folders, folder, ':');)
  {
    std::ifstream module(folder + path);
    for (std::string line; std::getline(module, line);)
    {
      char checksum[33] = {};
      int end = 0;
      std::sscanf(line.c_str(), " _md5sum = \"%32[0-9a-f]\"%n", checksum, &end);
      if (end != 0 && checksum[31] != '\0')
      {
        return checksum;
      }
    }
  }
  return datatype;
}

}  // namespace

XmlRpc::XmlRpcValue ask(const std::string& uri, const std::string& question, const std::string& argument,
                        Clock::time_point deadline)
{
  std::string host;
  std::uint32_t port = 0;
  XmlRpc::XmlRpcValue answer;
  bool is_answered = false;
  if (ros::network::splitURI(uri, host, port))
  {
    XmlRpc::XmlRpcValue request;
    request[0] = ros::this_node::getName();
    if (!argument.empty())
    {
      request[1] = argument;
    }
    // Of roscpp's pool, so mostly it is connected: a new connection is a new thread of the master.
    const auto clients = ros::XMLRPCManager::instance();
    auto& client = *clients->getXMLRPCClient(host, static_cast<int>(port), "/");
    if (client.executeNonBlock(question.c_str(), request))
    {
      const std::chrono::duration<double> left = deadline - Clock::now();
      client._disp.work(std::max(0.0, left.count()));  // returns when the answer is there
      is_answered = client.executeCheckDone(answer) && !client.isFault();
    }
    if (!is_answered)
    {
      client.close();  // an answer that is late must not be taken for that to the next question
    }
    clients->releaseXMLRPCClient(&client);
  }
  if (!is_answered || answer.getType() != XmlRpc::XmlRpcValue::TypeArray || answer.size() != 3 ||
      answer[0].getType() != XmlRpc::XmlRpcValue::TypeInt)
  {
    throw Refusal(uri + " does not answer");
  }
  return static_cast<int>(answer[0]) == 1 ? answer[2] : XmlRpc::XmlRpcValue();
}

XmlRpc::XmlRpcValue askMaster(const std::string& question, const std::string& argument,
                              Clock::time_point deadline)
{
  try
  {
    return ask(ros::master::getURI(), question, argument, deadline);
  }
  catch (const Refusal& refusal)
  {
    throw Refusal(std::string("the ROS master at ") + refusal.what());
  }
}

std::string MasterState::datatypeOf(const std::string& topic) const
{
  try
  {
    return typeOn(topic);
  }
  catch (const XmlRpc::XmlRpcException& error)
  {
    throw Refusal("the ROS master's answer is wrong: " + error.getMessage());
  }
}

std::string MasterState::typeOn(const std::string& topic) const
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

void MasterState::requireAnswer() const
{
  if (!state_.valid())
  {
    askMaster("getPid", "", deadline_);
  }
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
  catch (const XmlRpc::XmlRpcException&)
  {
    return "";  // nor does one whose answer is wrong
  }
}

bool isSameType(const std::string& one, const std::string& other)
{
  return one == other || canonical(one) == canonical(other);
}

}  // namespace dyknow
