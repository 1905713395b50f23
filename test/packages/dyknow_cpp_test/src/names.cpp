// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include <dyknow_msgs/Verdict.h>
#include <geometry_msgs/Point.h>
#include <nodelet/nodelet.h>
#include <ros/ros.h>
#include <std_msgs/Header.h>
#include <std_msgs/String.h>

#include <pluginlib/class_list_macros.hpp>
#include <string>
#include <vector>

namespace dyknow_cpp_test
{

/// Uses topics by all kinds of names, from handles of all kinds.
class Names : public nodelet::Nodelet
{
  void onInit() override
  {
    auto& nh = getNodeHandle();
    advertise(nh, "words");
    advertise(nh, "camera/image_raw");
    advertise(getPrivateNodeHandle(), "echo");
    advertise(nh, "/tf");
    advertise(ros::NodeHandle(nh, "left"), "image");
    advertise(nh, nh.resolveName("resolved"));
    advertise(nh, nh.resolveName("resolved") + "/compressed");
    advertise(nh, nh.resolveName("alone") + "/compressed");
    const std::string absolute = nh.resolveName("/absolute");
    for (const auto& topic : {absolute, nh.resolveName(absolute) + "/compressed"})
    {
      advertise(nh, topic);
    }
    const std::string seen = nh.resolveName("seen");
    for (const auto& topic :
         {nh.resolveName("annotated"), seen, ros::names::parentNamespace(seen) + "/camera_info"})
    {
      subscribers_.push_back(nh.subscribe(topic, 1, &Names::onMessage, this));
    }
    subscribers_.push_back(nh.subscribe("form/compressed", 1, &Names::onMessage, this));
    advertise(nh, "loop");
    subscribers_.push_back(nh.subscribe("loop", 1, &Names::onMessage, this));
    const std::string again = nh.subscribe("again", 1, &Names::onMessage, this).getTopic();
    subscribers_.push_back(nh.subscribe(nh.resolveName(again), 1, &Names::onMessage, this));
    subscribers_.push_back(nh.subscribe("/clock", 1, &Names::onMessage, this));
    subscribers_.push_back(nh.subscribe("verdict", 1, &Names::onVerdict, this));
    strings_ = nh.advertise<std_msgs::String>("text", 1);
    points_ = nh.advertise<geometry_msgs::Point>("point", 1);
  }

  void advertise(ros::NodeHandle nh, const std::string& topic)
  {
    publishers_.push_back(nh.advertise<std_msgs::Header>(topic, 1));
  }

  void onMessage(const std_msgs::HeaderConstPtr&) {}

  void onVerdict(const dyknow_msgs::VerdictConstPtr&) {}

  std::vector<ros::Publisher> publishers_;
  std::vector<ros::Subscriber> subscribers_;
  ros::Publisher strings_;
  ros::Publisher points_;
};

}  // namespace dyknow_cpp_test

PLUGINLIB_EXPORT_CLASS(dyknow_cpp_test::Names, nodelet::Nodelet)
