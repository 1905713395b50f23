// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

// A chain of hops in C++: the peer that the benchmark compares DyKnow with. What its parts do, their parameters,
// payloads and topics are described in parts.py.
#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>
#include <ros/ros.h>
#include <sensor_msgs/Image.h>
#include <std_msgs/Float64MultiArray.h>
#include <std_msgs/Time.h>
#include <std_srvs/Trigger.h>

#include <boost/make_shared.hpp>

#include <atomic>
#include <chrono>
#include <cstdio>
#include <iomanip>
#include <memory>
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

inline const ros::Time& stampOf(const std_msgs::Time& message)
{
  return message.data;
}

inline const ros::Time& stampOf(const sensor_msgs::Image& message)
{
  return message.header.stamp;
}

/// A time stamp; it has no size.
inline void fill(std_msgs::Time& message, const std::string&)
{
  message.data = ros::Time::now();
}

/// An image of a size such as 640x480.
inline void fill(sensor_msgs::Image& message, const std::string& size)
{
  unsigned width = 0, height = 0;
  std::sscanf(size.c_str(), "%ux%u", &width, &height);
  message.width = width;
  message.height = height;
  message.encoding = "rgb8";
  message.step = 3 * width;
  message.header.frame_id = "camera";
  message.data.assign(message.step * height, 0x7f);
  message.header.stamp = ros::Time::now();
}

class Part
{
public:
  virtual ~Part() = default;
};

/// Publishes stamped messages on `out` as ordered.
template <class Message>
class Source : public Part
{
public:
  Source(ros::NodeHandle nh, ros::NodeHandle private_nh)
    : payload_(private_nh.param<std::string>("payload", "time"))
    , out_(nh.advertise<Message>("out", 10))
    , send_(nh.subscribe(controlName(private_nh, "send"), 10, &Source::onSend, this))
  {
  }

  ~Source() override
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
      auto message = boost::make_shared<Message>();
      fill(*message, payload_);
      out_.publish(message);
    }
  }

  std::string payload_;
  ros::Publisher out_;
  ros::Subscriber send_;
  std::atomic<bool> stopped_{false};
  std::thread sender_;
};

/// Forwards what it receives on `in` to `out`; with ~record it reports how long that was on its way.
template <class Message>
class Hop : public Part
{
public:
  Hop(ros::NodeHandle nh, ros::NodeHandle private_nh)
    : hop_(private_nh.param("hop", 0))
    , record_(private_nh.param("record", false))
    , out_(nh.advertise<Message>("out", 10))
  {
    if (record_)
    {
      report_ = nh.advertiseService(controlName(private_nh, "report_" + std::to_string(hop_)), &Hop::onReport, this);
    }
    in_ = nh.subscribe("in", 10, &Hop::onMessage, this, ros::TransportHints().tcpNoDelay());
  }

private:
  void onMessage(const boost::shared_ptr<const Message>& message)
  {
    const ros::Time& stamp = stampOf(*message);
    const ros::Duration latency = ros::Time::now() - stamp;
    if (!record_)
    {
      arrivals_.clear();
    }
    arrivals_.emplace_back(stamp.toSec(), latency.toNSec() / 1e3);
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

/// Makes a part for its payload.
template <template <class> class Kind>
std::unique_ptr<Part> makePart(const ros::NodeHandle& nh, const ros::NodeHandle& private_nh)
{
  if (private_nh.param<std::string>("payload", "time") == "time")
  {
    return std::make_unique<Kind<std_msgs::Time>>(nh, private_nh);
  }
  return std::make_unique<Kind<sensor_msgs::Image>>(nh, private_nh);
}

/// A part as a nodelet of the stock C++ nodelet manager.
template <template <class> class Kind>
class ChainNodelet : public nodelet::Nodelet
{
  void onInit() override
  {
    part_ = makePart<Kind>(getNodeHandle(), getPrivateNodeHandle());
  }

  std::unique_ptr<Part> part_;
};

using SourceNodelet = ChainNodelet<Source>;
using HopNodelet = ChainNodelet<Hop>;

/// A part as a node: benchmark_chain source | hop
void runNode(int argc, char** argv)
{
  ros::init(argc, argv, "benchmark_chain", ros::init_options::AnonymousName);
  const bool is_source = argc == 2 && std::string(argv[1]) == "source";
  const auto part = (is_source ? makePart<Source> : makePart<Hop>)(ros::NodeHandle(), ros::NodeHandle("~"));
  ros::spin();
}

}  // namespace dyknow_benchmark

PLUGINLIB_EXPORT_CLASS(dyknow_benchmark::SourceNodelet, nodelet::Nodelet)
PLUGINLIB_EXPORT_CLASS(dyknow_benchmark::HopNodelet, nodelet::Nodelet)
