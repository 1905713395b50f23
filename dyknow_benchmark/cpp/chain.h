// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

// A chain of hops in C++: the peer that the benchmark compares DyKnow with.
//
// The source stamps messages at a fixed frequency, each hop compares the stamp with the time of arrival and forwards
// the message. Nothing is reported while messages flow: what a hop saw is kept until it is collected.
//
// Topics below the parameter ~control (the same for the parts in Python, see control_topics.py):
//   send     std_msgs/Float64MultiArray [count, frequency in Hz, start in s since the epoch]
//   collect  std_msgs/Empty
//   report   std_msgs/Float64MultiArray [stamp in s, latency in us, ...], layout.data_offset is the hop
#ifndef DYKNOW_BENCHMARK_CHAIN_H
#define DYKNOW_BENCHMARK_CHAIN_H

#include <ros/ros.h>
#include <std_msgs/Empty.h>
#include <std_msgs/Float64MultiArray.h>
#include <std_msgs/Time.h>

#include <atomic>
#include <thread>
#include <vector>

namespace dyknow_benchmark
{

/// Publishes time stamps on `out` when it is told to.
class Source
{
public:
  Source(ros::NodeHandle nh, ros::NodeHandle private_nh);
  ~Source();

private:
  void onSend(const std_msgs::Float64MultiArrayConstPtr& order);
  void send(double count, double frequency, double start);

  ros::Publisher out_;
  ros::Subscriber send_;
  std::atomic<bool> stopped_{false};
  std::thread sender_;
};

/// Forwards what it receives on `in` to `out` and notes how long it was on its way; with ~record it reports that.
class Hop
{
public:
  Hop(ros::NodeHandle nh, ros::NodeHandle private_nh);

private:
  void onMessage(const std_msgs::TimeConstPtr& message);
  void onCollect(const std_msgs::EmptyConstPtr&);

  int hop_;
  bool record_;  // otherwise only the latest arrival is kept
  std::vector<double> arrivals_;
  ros::Publisher out_;
  ros::Publisher report_;
  ros::Subscriber in_;
  ros::Subscriber collect_;
};

}  // namespace dyknow_benchmark

#endif
