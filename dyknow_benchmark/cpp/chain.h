// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

// A chain of hops in C++: the peer that the benchmark compares DyKnow with. What its parts do, their parameters and
// their topics are described in parts.py.
#ifndef DYKNOW_BENCHMARK_CHAIN_H
#define DYKNOW_BENCHMARK_CHAIN_H

#include <ros/ros.h>
#include <std_msgs/Float64MultiArray.h>
#include <std_msgs/Time.h>
#include <std_srvs/Trigger.h>

#include <boost/make_shared.hpp>

#include <atomic>
#include <chrono>
#include <iomanip>
#include <sstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace dyknow_benchmark
{

inline std::string controlName(const ros::NodeHandle& private_nh, const std::string& name)
{
  return private_nh.param<std::string>("control", "/benchmark") + "/" + name;
}

/// Publishes time stamps on `out` as ordered.
class Source
{
public:
  Source(ros::NodeHandle nh, ros::NodeHandle private_nh)
    : out_(nh.advertise<std_msgs::Time>("out", 10))
    , send_(nh.subscribe(controlName(private_nh, "send"), 10, &Source::onSend, this))
  {
  }

  ~Source()
  {
    stopped_ = true;
    join();
  }

private:
  void onSend(const std_msgs::Float64MultiArrayConstPtr& order)
  {
    join();
    sender_ = std::thread(&Source::send, this, order->data.at(0), order->data.at(1), order->data.at(2));
  }

  void join()
  {
    if (sender_.joinable())
    {
      sender_.join();
    }
  }

  void send(double count, double frequency, double start)
  {
    using Clock = std::chrono::system_clock;
    for (double sent = 0; sent < count && !stopped_; ++sent)
    {
      const std::chrono::duration<double> due(start + sent / frequency);
      std::this_thread::sleep_until(Clock::time_point(std::chrono::duration_cast<Clock::duration>(due)));
      auto message = boost::make_shared<std_msgs::Time>();
      message->data = ros::Time::now();
      out_.publish(message);
    }
  }

  ros::Publisher out_;
  ros::Subscriber send_;
  std::atomic<bool> stopped_{false};
  std::thread sender_;
};

/// Forwards what it receives on `in` to `out`; with ~record it reports how long that was on its way.
class Hop
{
public:
  Hop(ros::NodeHandle nh, ros::NodeHandle private_nh)
    : hop_(private_nh.param("hop", 0))
    , record_(private_nh.param("record", false))
    , out_(nh.advertise<std_msgs::Time>("out", 10))
  {
    if (record_)
    {
      report_ = nh.advertiseService(controlName(private_nh, "report_" + std::to_string(hop_)), &Hop::onReport, this);
    }
    in_ = nh.subscribe("in", 10, &Hop::onMessage, this, ros::TransportHints().tcpNoDelay());
  }

private:
  void onMessage(const std_msgs::TimeConstPtr& message)
  {
    const ros::Duration latency = ros::Time::now() - message->data;
    if (!record_)
    {
      arrivals_.clear();
    }
    arrivals_.emplace_back(message->data.toSec(), latency.toNSec() / 1e3);
    out_.publish(message);
  }

  bool onReport(std_srvs::Trigger::Request&, std_srvs::Trigger::Response& report)
  {
    std::ostringstream json;
    json << std::setprecision(17) << '[';
    for (const auto& arrival : arrivals_)
    {
      json << (json.tellp() > 1 ? "," : "") << '[' << arrival.first << ',' << arrival.second << ']';
    }
    json << ']';
    arrivals_.clear();
    report.message = json.str();
    return true;
  }

  int hop_;
  bool record_;  // otherwise only the latest arrival is kept
  std::vector<std::pair<double, double>> arrivals_;
  ros::Publisher out_;
  ros::ServiceServer report_;
  ros::Subscriber in_;
};

}  // namespace dyknow_benchmark

#endif
