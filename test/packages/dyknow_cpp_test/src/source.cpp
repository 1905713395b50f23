// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include <nodelet/nodelet.h>
#include <ros/ros.h>
#include <std_msgs/Header.h>
#include <std_srvs/Trigger.h>

#include <atomic>
#include <chrono>
#include <pluginlib/class_list_macros.hpp>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace dyknow_cpp_test
{

/// Numbers its messages and signs them with its name and their address. Counts messages that it hears.
class Source : public nodelet::Nodelet
{
public:
  ~Source() override
  {
    stopped_ = true;
    if (sender_.joinable())
    {
      sender_.join();
    }
  }

private:
  void onInit() override
  {
    auto& private_nh = getPrivateNodeHandle();
    is_by_value_ = private_nh.param("by_value", false);
    const bool is_latched = private_nh.param("latch", false);
    if (private_nh.param("watched", false))
    {
      out_ = getNodeHandle().advertise<std_msgs::Header>(
          "out", 1000, [this](const ros::SingleSubscriberPublisher&) { ++watchers_; },
          [this](const ros::SingleSubscriberPublisher&) { --watchers_; }, ros::VoidConstPtr(), is_latched);
    }
    else
    {
      out_ = getNodeHandle().advertise<std_msgs::Header>("out", 1000, is_latched);
    }
    if (private_nh.param("listens", false))
    {
      in_ = getNodeHandle().subscribe("in", 1000, &Source::onMessage, this);
    }
    start_ = private_nh.advertiseService("start", &Source::onStart, this);
    report_ = private_nh.advertiseService("report", &Source::onReport, this);
  }

  void onMessage(const std_msgs::HeaderConstPtr& message)
  {
    ++(message->frame_id.rfind(getName() + "@", 0) == 0 ? own_ : others_);
  }

  bool onStart(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& answer)
  {
    if (sender_.joinable())
    {
      sender_.join();
    }
    const auto& private_nh = getPrivateNodeHandle();
    if (private_nh.param("late", false))
    {
      const std::string late = getNodeHandle().resolveName("late");
      late_.clear();
      const std::string global = "/global";
      for (const auto& topic : {late + "/compressed", late, global + "/compressed", global})
      {
        late_.push_back(getNodeHandle().advertise<std_msgs::Header>(topic, 1));
      }
    }
    sender_ =
        std::thread(&Source::send, this, private_nh.param("count", 1), private_nh.param("rate", 1000.0));
    answer.success = true;
    return true;
  }

  bool onReport(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& answer)
  {
    answer.message = "{\"sent\": " + std::to_string(sent_) +
                     ", \"listeners\": " + std::to_string(out_.getNumSubscribers()) +
                     ", \"watchers\": " + std::to_string(watchers_) + ", \"own\": " + std::to_string(own_) +
                     ", \"others\": " + std::to_string(others_) + "}";
    answer.success = true;
    return true;
  }

  void send(int count, double rate)
  {
    const auto start = std::chrono::steady_clock::now();
    for (int i = 0; i < count && !stopped_; ++i)
    {
      const std::chrono::duration<double> due(i / rate);
      std::this_thread::sleep_until(start + std::chrono::duration_cast<std::chrono::nanoseconds>(due));
      const auto message = boost::make_shared<std_msgs::Header>();
      std::ostringstream signature;
      signature << getName() << "@" << message.get();
      message->seq = sent_;
      message->frame_id = signature.str();
      ++sent_;
      if (is_by_value_)
      {
        out_.publish(*message);
      }
      else
      {
        out_.publish(message);
      }
    }
  }

  ros::Publisher out_;
  ros::Subscriber in_;
  std::vector<ros::Publisher> late_;
  ros::ServiceServer start_;
  ros::ServiceServer report_;
  bool is_by_value_ = false;  // its messages are serialised within the process too
  std::atomic<int> watchers_{0};  // connect callbacks less disconnect callbacks
  std::atomic<int> sent_{0};
  std::atomic<int> own_{0};     // messages of its own that it has heard
  std::atomic<int> others_{0};  // and of others
  std::atomic<bool> stopped_{false};
  std::thread sender_;
};

}  // namespace dyknow_cpp_test

PLUGINLIB_EXPORT_CLASS(dyknow_cpp_test::Source, nodelet::Nodelet)
