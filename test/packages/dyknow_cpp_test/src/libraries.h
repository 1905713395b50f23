// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#ifndef DYKNOW_CPP_TEST_LIBRARIES_H
#define DYKNOW_CPP_TEST_LIBRARIES_H

#include <image_transport/camera_publisher.h>
#include <image_transport/camera_subscriber.h>
#include <image_transport/image_transport.h>
#include <message_filters/subscriber.h>
#include <message_filters/time_synchronizer.h>
#include <ros/ros.h>
#include <std_srvs/Trigger.h>
#include <tf2_ros/transform_listener.h>

#include <array>
#include <atomic>
#include <cstdio>
#include <string>

namespace dyknow_cpp_test
{

/// Uses topics by way of the libraries that most nodes use them by.
class Libraries
{
public:
  Libraries(ros::NodeHandle nh, ros::NodeHandle private_nh)
    : transport_(nh)
    , images_(transport_.advertiseCamera("out/image", 5))
    , camera_(transport_.subscribeCamera("camera/image", 5, &Libraries::onImage, this))
    , left_(nh, "left", 10)
    , right_(nh, "right", 10)
    , pairs_(left_, right_, 10)
    , listener_(transforms_, nh)
    , timer_(nh.createTimer(ros::Duration(0.05), &Libraries::onTimer, this))
    , report_(private_nh.advertiseService("report", &Libraries::onReport, this))
    , environment_(private_nh.advertiseService("environment", &Libraries::onEnvironment, this))
  {
    pairs_.registerCallback(&Libraries::onPair, this);
  }

private:
  void onImage(const sensor_msgs::ImageConstPtr& image, const sensor_msgs::CameraInfoConstPtr& info)
  {
    width_ = info->width;
    images_.publish(image, info);
  }

  void onPair(const sensor_msgs::CameraInfoConstPtr&, const sensor_msgs::CameraInfoConstPtr&) { ++paired_; }

  void onTimer(const ros::TimerEvent&) { ++ticks_; }

  bool onReport(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& answer)
  {
    answer.message = "{\"width\": " + std::to_string(width_) + ", \"pairs\": " + std::to_string(paired_) +
                     ", \"ticks\": " + std::to_string(ticks_) + ", \"transforms\": " +
                     std::to_string(transforms_.canTransform("map", "base", ros::Time(0))) + "}";
    answer.success = true;
    return true;
  }

  /// Reports the environment of a child of this process.
  bool onEnvironment(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& answer)
  {
    std::FILE* output = popen("env", "r");
    std::array<char, 1024> part;
    while (output != nullptr && std::fgets(part.data(), part.size(), output) != nullptr)
    {
      answer.message += part.data();
    }
    answer.success = output != nullptr && pclose(output) == 0;
    return true;
  }

  image_transport::ImageTransport transport_;
  image_transport::CameraPublisher images_;
  image_transport::CameraSubscriber camera_;
  message_filters::Subscriber<sensor_msgs::CameraInfo> left_;
  message_filters::Subscriber<sensor_msgs::CameraInfo> right_;
  message_filters::TimeSynchronizer<sensor_msgs::CameraInfo, sensor_msgs::CameraInfo> pairs_;
  tf2_ros::Buffer transforms_;
  tf2_ros::TransformListener listener_;
  ros::Timer timer_;
  ros::ServiceServer report_;
  ros::ServiceServer environment_;
  std::atomic<unsigned> width_{0};
  std::atomic<unsigned> paired_{0};
  std::atomic<unsigned> ticks_{0};
};

}  // namespace dyknow_cpp_test

#endif
