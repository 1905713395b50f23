// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include <nodelet/NodeletUnload.h>
#include <nodelet/nodelet.h>
#include <ros/ros.h>
#include <std_msgs/Header.h>
#include <std_srvs/Trigger.h>

#include <iostream>
#include <map>
#include <mutex>
#include <pluginlib/class_list_macros.hpp>
#include <sstream>
#include <string>
#include <thread>

namespace dyknow_cpp_test
{

/// Checks the numbers and addresses of messages, in the order in which its callbacks begin.
///
/// Between two messages of one source none may be missing, unless another source's came in between.
class Sink : public nodelet::Nodelet
{
public:
  ~Sink() override
  {
    ros::WallDuration(last_delay_).sleep();
    std::thread([this] { report_.shutdown(); }).join();
    std::cout << getName() << " is destroyed" << std::endl;
  }

private:
  void onInit() override
  {
    auto& private_nh = getPrivateNodeHandle();
    delay_ = private_nh.param("delay", 0.0);
    last_delay_ = private_nh.param("last_delay", 0.0);
    leaves_ = private_nh.param("leaves", false);
    adds_ = private_nh.param("adds", false);
    auto& nh = private_nh.param("mt", false) ? getMTNodeHandle() : getNodeHandle();
    const int queue_size = private_nh.param("queue_size", 1000);
    in_ = nh.subscribe("in", queue_size, &Sink::onMessage, this);
    if (private_nh.param("second", false))
    {
      second_ = nh.subscribe("second", queue_size, &Sink::onMessage, this);
    }
    report_ = private_nh.advertiseService("report", &Sink::onReport, this);
  }

  void onMessage(const std_msgs::HeaderConstPtr& message)
  {
    note(*message);
    ros::WallDuration(delay_).sleep();
    if (adds_)
    {
      second_ = getNodeHandle().subscribe("second", 1, &Sink::onMessage, this);
    }
  }

  void note(const std_msgs::Header& message)
  {
    const auto at = message.frame_id.rfind('@');
    const std::string source = message.frame_id.substr(0, at);
    std::ostringstream address;
    address << &message;
    const std::lock_guard<std::mutex> lock(mutex_);
    ++received_;
    copied_ += address.str() == message.frame_id.substr(at + 1) ? 0 : 1;
    const auto before = next_.find(source);
    if (before != next_.end())
    {
      doubled_ += message.seq + 1 == before->second ? 1 : 0;
      reordered_ += message.seq + 1 < before->second ? 1 : 0;
      lost_ += source == last_ && message.seq > before->second ? message.seq - before->second : 0;
    }
    switches_ += last_ != source ? 1 : 0;
    last_ = source;
    next_[source] = message.seq + 1;
  }

  bool onReport(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& answer)
  {
    if (leaves_)
    {
      nodelet::NodeletUnload unload;
      unload.request.name = getName();
      ros::service::call(ros::this_node::getName() + "/unload_nodelet", unload);
    }
    const std::lock_guard<std::mutex> lock(mutex_);
    std::ostringstream text;
    text << "{\"received\": " << received_ << ", \"lost\": " << lost_ << ", \"doubled\": " << doubled_
         << ", \"reordered\": " << reordered_ << ", \"copied\": " << copied_
         << ", \"switches\": " << switches_ << ", \"publishers\": " << in_.getNumPublishers() << "}";
    answer.message = text.str();
    answer.success = true;
    return true;
  }

  double delay_ = 0.0;       // of each callback
  double last_delay_ = 0.0;  // of the end
  bool leaves_ = false;      // with its first report
  bool adds_ = false;        // a subscription at the end of each callback
  ros::Subscriber in_;
  ros::Subscriber second_;
  ros::ServiceServer report_;
  std::mutex mutex_;
  std::map<std::string, unsigned> next_;
  std::string last_;
  unsigned received_ = 0;
  unsigned lost_ = 0;
  unsigned doubled_ = 0;
  unsigned reordered_ = 0;
  unsigned copied_ = 0;
  unsigned switches_ = 0;
};

}  // namespace dyknow_cpp_test

PLUGINLIB_EXPORT_CLASS(dyknow_cpp_test::Sink, nodelet::Nodelet)
