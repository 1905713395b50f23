// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "question.h"

#include <ros/master.h>
#include <ros/network.h>
#include <ros/this_node.h>
#include <xmlrpcpp/XmlRpcClient.h>

#include <algorithm>

#include "problems.h"

namespace dyknow
{

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
    XmlRpc::XmlRpcClient client(host.c_str(), static_cast<int>(port), "/");
    if (client.executeNonBlock(question.c_str(), request))
    {
      const std::chrono::duration<double> left = deadline - Clock::now();
      client._disp.work(std::max(0.0, left.count()));  // returns when the answer is there
      is_answered = client.executeCheckDone(answer) && !client.isFault();
    }
    client._disp.removeSource(&client);
    client.close();
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

}  // namespace dyknow
