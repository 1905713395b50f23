// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include <dyknow/node_handle.h>
#include <nodelet/nodelet.h>
#include <std_msgs/Float64.h>

#include <pluginlib/class_list_macros.hpp>

namespace dyknow_cpp_example
{

/// Publishes the mean of what came on `in` since that was connected to its topic.
class Smoother : public nodelet::Nodelet
{
  void onInit() override
  {
    nh_ = dyknow::NodeHandle(getNodeHandle());
    out_ = nh_.advertise<std_msgs::Float64>("out", 10);
    in_ = nh_.subscribe("in", 10, &Smoother::onNumber, this);
    nh_.setReconfigureCallback(
        [this](const dyknow::PortTopics& inputs, const dyknow::PortTopics&)
        {
          NODELET_INFO("the mean of '%s' begins", inputs.at("in").c_str());
          sum_ = 0.0;
          count_ = 0;
        });
  }

  void onNumber(const std_msgs::Float64ConstPtr& number)
  {
    std_msgs::Float64 mean;
    sum_ += number->data;
    mean.data = sum_ / ++count_;
    out_.publish(mean);
  }

  dyknow::NodeHandle nh_;
  ros::Publisher out_;
  ros::Subscriber in_;
  double sum_ = 0.0;
  int count_ = 0;
};

}  // namespace dyknow_cpp_example

PLUGINLIB_EXPORT_CLASS(dyknow_cpp_example::Smoother, nodelet::Nodelet)
