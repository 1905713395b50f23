// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "process_services.h"

#include <dyknow_msgs/GetConfig.h>
#include <dyknow_msgs/GetCounts.h>
#include <dyknow_msgs/GetStatistics.h>
#include <dyknow_msgs/NodeletChanges.h>
#include <dyknow_msgs/RenewLease.h>
#include <dyknow_msgs/SetConfig.h>
#include <ros/advertise_service_options.h>
#include <ros/callback_queue.h>
#include <ros/service_manager.h>
#include <ros/single_subscriber_publisher.h>
#include <ros/this_node.h>

#include <algorithm>
#include <limits>
#include <mutex>
#include <set>
#include <thread>

#include "guards.h"
#include "later.h"
#include "leases.h"
#include "names.h"
#include "problems.h"
#include "registry.h"
#include "stuck_callbacks.h"
#include "topics.h"

namespace dyknow
{
namespace
{

constexpr int THREADS = 4;
/// In which changes that follow an announced one are collected.
constexpr std::chrono::milliseconds WINDOW(20);
constexpr int QUEUE_SIZE = 1000;
/// Where a node with live ports announces its name, and changes of it; a nodelet manager is found otherwise.
constexpr char NODES[] = "/dyknow/rewirable_nodes";
/// Characters of one text in the log.
constexpr std::size_t LONGEST_LOG = 4096;

ros::Duration toRos(Clock::duration duration)
{
  return ros::Duration(std::chrono::duration<double>(duration).count());
}

std::string forLog(const std::string& text)
{
  return text.size() <= LONGEST_LOG
             ? text
             : text.substr(0, LONGEST_LOG) + "... (" + std::to_string(text.size()) + " characters)";
}

std::uint8_t directionOf(const Port& port)
{
  return port.direction == Direction::OUT ? dyknow_msgs::Port::OUT : dyknow_msgs::Port::IN;
}

/// Ports sorted by name.
std::vector<NodeletProxy::NamedPort> sortedPorts(const NodeletProxy& proxy)
{
  auto ports = proxy.ports();
  std::sort(ports.begin(), ports.end(), [](const auto& a, const auto& b) { return a.name < b.name; });
  return ports;
}

using GetConfigEvent = ros::ServiceEvent<dyknow_msgs::GetConfig::Request, dyknow_msgs::GetConfig::Response>;
using SetConfigEvent = ros::ServiceEvent<dyknow_msgs::SetConfig::Request, dyknow_msgs::SetConfig::Response>;
using GetStatisticsEvent =
    ros::ServiceEvent<dyknow_msgs::GetStatistics::Request, dyknow_msgs::GetStatistics::Response>;
using GetCountsEvent = ros::ServiceEvent<dyknow_msgs::GetCounts::Request, dyknow_msgs::GetCounts::Response>;
using RenewLeaseEvent = ros::ServiceEvent<dyknow_msgs::RenewLease::Request, dyknow_msgs::RenewLease::Response>;

bool getConfig(const NodeletProxy& proxy, GetConfigEvent& event)
{
  for (const auto& each : proxy.ports())
  {
    dyknow_msgs::Port port;
    port.name = each.name;
    port.direction = directionOf(*each.port);
    port.datatype = each.port->datatype();
    port.topic = each.port->topic();
    event.getResponse().ports.push_back(port);
  }
  return true;
}

bool setConfig(NodeletProxy& proxy, SetConfigEvent& event)
{
  const std::string caller = event.getCallerName();
  auto& answer = event.getResponse();
  NodeletProxy::Config config;
  std::string told;
  for (const auto& each : event.getRequest().config)
  {
    config.emplace_back(each.port, each.topic);
    told +=
        (told.empty() ? "'" : ", '") + each.port + "' to " + (each.topic.empty() ? "nothing" : each.topic);
  }
  try
  {
    proxy.setConfig(config, caller);
  }
  catch (const Refusal& refusal)
  {
    ROS_ERROR("%s: set_config of %s: %s", proxy.name.c_str(), forLog(caller).c_str(),
              forLog(refusal.what()).c_str());
    answer.message = refusal.what();
    return true;
  }
  ROS_INFO("%s: %s connected %s", proxy.name.c_str(), forLog(caller).c_str(), forLog(told).c_str());
  answer.success = true;
  return true;
}

bool getStatistics(const NodeletProxy& proxy, GetStatisticsEvent& event)
{
  auto& answer = event.getResponse();
  answer.uptime = toRos(Clock::now() - proxy.started);
  answer.reconfigurations = proxy.reconfigurations();
  for (const auto& each : sortedPorts(proxy))
  {
    const auto counts = each.port->statistics();
    dyknow_msgs::PortStatistics port;
    port.port = each.name;
    port.direction = directionOf(*each.port);
    port.topic = each.port->topic();
    port.messages = counts.messages;
    port.dropped = counts.dropped;
    port.rate = counts.rate;
    port.mean_callback = toRos(counts.busy / std::max<std::uint64_t>(counts.messages, 1));
    port.max_callback = toRos(counts.longest);
    answer.ports.push_back(port);
  }
  return true;
}

bool renewLease(RenewLeaseEvent& event)
{
  const auto& request = event.getRequest();
  if (request.topics.size() != request.nodelets.size())
  {
    return false;
  }
  Leases::Producers producers;
  for (std::size_t i = 0; i < request.topics.size(); ++i)
  {
    producers[request.topics[i]] = request.nodelets[i];
  }
  event.getResponse().clock = Leases::instance().renew(event.getCallerName(), request.uri, request.confirmed,
                                                       request.duration, producers);
  return true;
}

bool getCounts(GetCountsEvent& event)
{
  const auto& wanted = event.getRequest().nodelets;
  const std::set<std::string> names(wanted.begin(), wanted.end());
  for (const auto& proxy : Registry::instance().owners())
  {
    if (!names.empty() && names.count(proxy->name) == 0)
    {
      continue;
    }
    dyknow_msgs::NodeletCounts nodelet;
    nodelet.nodelet = proxy->name;
    nodelet.uptime = toRos(Clock::now() - proxy->started);
    for (const auto& each : sortedPorts(*proxy))
    {
      dyknow_msgs::PortCount port;
      port.port = each.name;
      port.direction = directionOf(*each.port);
      port.messages = each.port->statistics().messages;
      port.latched = each.port->latched;
      port.age = std::numeric_limits<double>::quiet_NaN();  // not measured here
      nodelet.ports.push_back(port);
    }
    event.getResponse().nodelets.push_back(nodelet);
  }
  const std::string loader = names::join(ros::this_node::getName(), "load_nodelet");
  const bool is_manager = ros::ServiceManager::instance()->lookupServicePublication(loader) != nullptr;
  event.getResponse().kind = is_manager ? "cpp_nodelet" : "cpp_node";
  return true;
}

/// The topic on which a nodelet manager announces changes.
std::string changesTopic()
{
  return names::join(ros::this_node::getName(), "changes");
}

/// The services of this process; leaked on purpose, see later.cpp.
///
/// Without any ros::NodeHandle: a node ends with its last one, which must not be ours. The next one may start
/// roscpp again, and nothing is offered then that was before.
///
/// Locks: `turn_lock_` is held over everything that is offered or withdrawn, which asks the ROS master;
/// `state_lock_` guards the changes to announce.
class Services
{
public:
  static Services& instance()
  {
    static Services& services = *new Services;
    return services;
  }

  void offer(const std::shared_ptr<NodeletProxy>& proxy)
  {
    const std::lock_guard<std::mutex> turn(turn_lock_);
    offerInTurn(proxy);
  }

  void offerManager()
  {
    const std::lock_guard<std::mutex> turn(turn_lock_);
    offerProcessInTurn();
    advertise(changesTopic(), &Services::tellEverything);
  }

  void offerEverything()
  {
    {
      const std::lock_guard<std::mutex> turn(turn_lock_);
      for (const auto& each : Registry::instance().owners())
      {
        if (each->is_offered)
        {
          offerInTurn(each);
        }
      }
    }
    tell();  // announcements that were pending when roscpp was shut down
  }

  void withdraw(NodeletProxy& proxy)
  {
    const std::lock_guard<std::mutex> turn(turn_lock_);
    proxy.is_offered = false;
    for (const char* each : {"/get_config", "/set_config", "/get_statistics"})
    {
      ros::ServiceManager::instance()->unadvertiseService(proxy.name + each);
    }
  }

  void announce(const std::string& nodelet)
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    if (changed_.empty())
    {
      later([this] { tell(); }, std::max(Clock::now(), told_ + WINDOW));
    }
    changed_.insert(nodelet);
  }

private:
  Services()
  {
    for (int i = 0; i < THREADS; ++i)
    {
      // No ros::AsyncSpinner: it has a ros::NodeHandle, and wakes up ten times a second.
      std::thread(&Services::serve, this).detach();
    }
  }

  void offerProcessInTurn()
  {
    advertise<GetCountsEvent>(names::join(ros::this_node::getName(), "get_counts"), getCounts);
    advertise<RenewLeaseEvent>(names::join(ros::this_node::getName(), "renew_lease"), renewLease);
  }

  void offerInTurn(const std::shared_ptr<NodeletProxy>& proxy)
  {
    offerProcessInTurn();
    advertise<GetConfigEvent>(proxy->name + "/get_config",
                              [proxy](GetConfigEvent& event) { return getConfig(*proxy, event); });
    advertise<SetConfigEvent>(proxy->name + "/set_config",
                              [proxy](SetConfigEvent& event) { return setConfig(*proxy, event); });
    advertise<GetStatisticsEvent>(proxy->name + "/get_statistics", [proxy](GetStatisticsEvent& event)
                                  { return getStatistics(*proxy, event); });
    if (proxy->name == ros::this_node::getName())
    {
      advertise(NODES, &Services::tellName);  // last: subscribers query immediately
    }
  }

  void serve()
  {
    for (;;)
    {
      queue_.callOne(ros::WallDuration(std::chrono::duration<double>(std::chrono::hours(1)).count()));
    }
  }

  /// Publishes a topic unless it is; `greet` is called with every new subscriber.
  void advertise(const std::string& topic, const ros::SubscriberStatusCallback& greet)
  {
    if (!topics::isUp() || topics::publication(topic))
    {
      return;
    }
    const ros::SubscriberStatusCallback none;
    const auto options = ros::AdvertiseOptions::create<dyknow_msgs::NodeletChanges>(
        topic, QUEUE_SIZE, greet, none, ros::VoidConstPtr(), &queue_);
    const topics::WiringLock lock;
    topics::advertise(
        lock, options,
        boost::make_shared<ros::SubscriberCallbacks>(greet, none, ros::VoidConstPtr(), &queue_));
  }

  /// Offers a service unless it is.
  template <class Event, class Answer>
  void advertise(const std::string& name, Answer answer)
  {
    if (!topics::isUp() || ros::ServiceManager::instance()->lookupServicePublication(name))
    {
      return;
    }
    ros::AdvertiseServiceOptions options;
    options.initBySpecType<Event>(name, answer);
    options.callback_queue = &queue_;
    ros::ServiceManager::instance()->advertiseService(options);
  }

  /// A newcomer may have missed changes.
  static void tellEverything(const ros::SingleSubscriberPublisher& newcomer)
  {
    std::set<std::string> nodelets;
    for (const auto& each : Registry::instance().owners())
    {
      nodelets.insert(each->name);
    }
    if (!nodelets.empty())
    {
      newcomer.publish(messageOf(nodelets));
    }
  }

  static void tellName(const ros::SingleSubscriberPublisher& newcomer)
  {
    newcomer.publish(messageOf({ros::this_node::getName()}));
  }

  static dyknow_msgs::NodeletChanges messageOf(const std::set<std::string>& nodelets)
  {
    dyknow_msgs::NodeletChanges message;
    for (const auto& each : nodelets)
    {
      message.nodelets.push_back(each);
      message.details.push_back(stuckCallback(each));
    }
    return message;
  }

  static void publish(const std::string& topic, const std::set<std::string>& nodelets)
  {
    if (const auto publication = topics::publication(topic))
    {
      const auto message = messageOf(nodelets);
      ros::SerializedMessage serialised;
      topics::publish(
          *publication, [&message] { return ros::serialization::serializeMessage(message); }, serialised);
    }
  }

  void tell()
  {
    std::set<std::string> changed;
    {
      std::lock_guard<std::mutex> lock(state_lock_);
      changed.swap(changed_);
      told_ = Clock::now();
    }
    if (!topics::isUp() || changed.empty())
    {
      return;
    }
    publish(changesTopic(), changed);
    if (changed.count(ros::this_node::getName()) > 0)
    {
      publish(NODES, {ros::this_node::getName()});
    }
  }

  ros::CallbackQueue queue_;
  std::mutex turn_lock_;
  std::mutex state_lock_;
  std::set<std::string> changed_;
  Clock::time_point told_;
};

}  // namespace

void offerServices(const std::shared_ptr<NodeletProxy>& proxy)
{
  if (!proxy->is_offered.exchange(true))
  {
    Services::instance().offer(proxy);
    announceChange(proxy->name);
  }
}

void withdrawServices(NodeletProxy& proxy)
{
  Services::instance().withdraw(proxy);
  announceChange(proxy.name);
}

void offerManagerServices()
{
  Services::instance().offerManager();
}

void offerServicesAgain()
{
  Services::instance().offerEverything();
}

bool isOwnTopic(const std::string& topic)
{
  return topic == NODES || topic == changesTopic();
}

void announceChange(const std::string& nodelet)
{
  Services::instance().announce(nodelet);
}

}  // namespace dyknow
