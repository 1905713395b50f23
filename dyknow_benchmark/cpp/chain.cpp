// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "chain.h"

#include <boost/make_shared.hpp>

#include <chrono>

namespace dyknow_benchmark
{
namespace
{

std::string controlTopic(const ros::NodeHandle& private_nh, const std::string& name)
{
  return private_nh.param<std::string>("control", "/benchmark") + "/" + name;
}

}  // namespace

Source::Source(ros::NodeHandle nh, ros::NodeHandle private_nh)
  : out_(nh.advertise<std_msgs::Time>("out", 10))
  , send_(nh.subscribe(controlTopic(private_nh, "send"), 10, &Source::onSend, this))
{
}

Source::~Source()
{
  stopped_ = true;
  if (sender_.joinable())
  {
    sender_.join();
  }
}

void Source::onSend(const std_msgs::Float64MultiArrayConstPtr& order)
{
  if (order->data.size() != 3)
  {
    ROS_ERROR("expected [count, frequency, start], got %zu numbers", order->data.size());
    return;
  }
  if (sender_.joinable())
  {
    sender_.join();
  }
  sender_ = std::thread(&Source::send, this, order->data[0], order->data[1], order->data[2]);
}

void Source::send(double count, double frequency, double start)
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

Hop::Hop(ros::NodeHandle nh, ros::NodeHandle private_nh)
  : hop_(private_nh.param("hop", 0))
  , record_(private_nh.param("record", false))
  , out_(nh.advertise<std_msgs::Time>("out", 10))
{
  // The other topics first: nothing must arrive before it can be dealt with.
  if (record_)
  {
    // The hops of a process share the queue of the topic, and all report at once.
    report_ = nh.advertise<std_msgs::Float64MultiArray>(controlTopic(private_nh, "report"), 1000);
    collect_ = nh.subscribe(controlTopic(private_nh, "collect"), 10, &Hop::onCollect, this);
  }
  in_ = nh.subscribe("in", 10, &Hop::onMessage, this, ros::TransportHints().tcpNoDelay());
}

void Hop::onMessage(const std_msgs::TimeConstPtr& message)
{
  const ros::Duration latency = ros::Time::now() - message->data;
  if (!record_)
  {
    arrivals_.clear();
  }
  arrivals_.push_back(message->data.toSec());
  arrivals_.push_back(latency.toNSec() / 1e3);
  out_.publish(message);
}

void Hop::onCollect(const std_msgs::EmptyConstPtr&)
{
  std_msgs::Float64MultiArray report;
  report.layout.data_offset = hop_;
  report.data.swap(arrivals_);
  report_.publish(report);
}

}  // namespace dyknow_benchmark
