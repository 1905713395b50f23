// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>
#include <ros/ros.h>
#include <std_msgs/String.h>

namespace dyknow_cpp_test
{

/// Advertises before it is a nodelet, as one with a server of dynamic_reconfigure for a member does.
class Eager : public nodelet::Nodelet
{
private:
  void onInit() override
  {
    out_ = getNodeHandle().advertise<std_msgs::String>("out", 10);
    in_ = getNodeHandle().subscribe("in", 10, &Eager::onMessage, this);
  }

  void onMessage(const std_msgs::StringConstPtr& message) { out_.publish(message); }

  ros::Publisher early_ = ros::NodeHandle("~").advertise<std_msgs::String>("early", 1);
  ros::Publisher out_;
  ros::Subscriber in_;
};

}  // namespace dyknow_cpp_test

PLUGINLIB_EXPORT_CLASS(dyknow_cpp_test::Eager, nodelet::Nodelet)
