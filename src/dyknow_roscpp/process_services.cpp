// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "process_services.h"

#include <dyknow_msgs/GetConfig.h>
#include <dyknow_msgs/GetStatistics.h>
#include <dyknow_msgs/NodeletChanges.h>
#include <dyknow_msgs/Poll.h>
#include <dyknow_msgs/SetConfig.h>
#include <ros/advertise_service_options.h>
#include <ros/callback_queue.h>
#include <ros/service_manager.h>
#include <ros/service_publication.h>
#include <ros/single_subscriber_publisher.h>
#include <ros/this_node.h>
#include <ros/xmlrpc_manager.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <limits>
#include <map>
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
/// Where a process with live ports announces its nodelets, and changes of them: DyKnow managers find it by that.
constexpr char NODES[] = "/dyknow/rewirable_nodes";
/// What each nodelet and node offers, below its name.
constexpr std::array<const char*, 3> SERVICES{"/get_config", "/set_config", "/get_statistics"};
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
using PollEvent = ros::ServiceEvent<dyknow_msgs::Poll::Request, dyknow_msgs::Poll::Response>;

std::vector<dyknow_msgs::Port> portsOf(const NodeletProxy& proxy)
{
  std::vector<dyknow_msgs::Port> ports;
  for (const auto& each : proxy.ports())
  {
    dyknow_msgs::Port port;
    port.name = each.name;
    port.direction = directionOf(*each.port);
    port.datatype = each.port->datatype();
    port.topic = each.port->topic();
    ports.push_back(port);
  }
  return ports;
}

bool getConfig(const NodeletProxy& proxy, GetConfigEvent& event)
{
  event.getResponse().ports = portsOf(proxy);
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

dyknow_msgs::NodeletCounts countsOf(const NodeletProxy& proxy)
{
  dyknow_msgs::NodeletCounts nodelet;
  nodelet.nodelet = proxy.name;
  nodelet.uptime = toRos(Clock::now() - proxy.started);
  nodelet.reconfigurations = proxy.reconfigurations();  // before the counts
  for (const auto& each : sortedPorts(proxy))
  {
    dyknow_msgs::PortCount port;
    port.port = each.name;
    port.direction = directionOf(*each.port);
    const auto counts = each.port->statistics();
    port.messages = counts.messages;
    port.dropped = counts.dropped;
    port.latched = each.port->latched;
    port.age = std::numeric_limits<double>::quiet_NaN();  // neither this nor the size is measured here
    nodelet.ports.push_back(port);
    nodelet.busy += std::chrono::duration<double>(counts.busy).count();
  }
  return nodelet;
}

/// Adds what this process takes to the counts of its only nodelet.
void addProcess(dyknow_msgs::NodeletCounts& counts)
{
  counts.cpu = static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
  std::ifstream file("/proc/self/statm");
  std::uint64_t size = 0, resident = 0;
  if (file >> size >> resident)
  {
    counts.memory = resident * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
  }
}

/// Share of the memory that is in use; NaN if it is not known.
double memoryInUse()
{
  std::ifstream file("/proc/meminfo");
  std::map<std::string, double> found;
  std::string name, rest;
  double kilobytes = 0.0;
  while (found.count("MemAvailable:") == 0 && file >> name >> kilobytes && std::getline(file, rest))
  {
    found[name] = kilobytes;
  }
  const double total = found["MemTotal:"];
  return found.count("MemAvailable:") > 0 && total > 0.0 ? 1.0 - found["MemAvailable:"] / total
                                                         : std::numeric_limits<double>::quiet_NaN();
}

dyknow_msgs::Machine machine()
{
  dyknow_msgs::Machine found;
  double load = 0.0;
  found.cores = std::max(std::thread::hardware_concurrency(), 1U);
  found.load = getloadavg(&load, 1) == 1 ? load / found.cores : std::numeric_limits<double>::quiet_NaN();
  found.memory = memoryInUse();
  const auto now = ros::WallTime::now();
  found.stamp = ros::Time(now.sec, now.nsec);
  return found;
}

void renewLease(const dyknow_msgs::Poll::Request& request, const std::string& caller)
{
  Leases::Producers producers;
  for (std::size_t i = 0; i < request.topics.size(); ++i)
  {
    producers[request.topics[i]] = request.nodelets[i];
  }
  Leases::instance().renew(caller, request.uri, request.confirmed, request.duration, producers);
}

bool isNodeletManager()
{
  const std::string loader = names::join(ros::this_node::getName(), "load_nodelet");
  return ros::ServiceManager::instance()->lookupServicePublication(loader) != nullptr;
}

/// The service that DyKnow managers poll.
std::string pollService()
{
  return names::join(ros::this_node::getName(), "poll");
}

/// Whether the node's own code has offered a service of that name, which is registered then.
std::atomic<bool> g_is_poll_taken{false};

/// The services of this process; leaked on purpose, see later.cpp.
///
/// Without any ros::NodeHandle: a node ends with its last one, which must not be ours. The next one may start
/// roscpp again, and nothing is offered then that was before.
///
/// Locks: `turn_lock_` is held over everything that is offered or withdrawn, which asks the ROS master;
/// `state_lock_` guards the numbers of changes. A nodelet is described after the number of its last change was
/// taken, so the description contains that change.
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
    Guards::readRewirable();
    offerProcessInTurn();
    advertiseChanges();
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
    for (const char* each : SERVICES)
    {
      ros::ServiceManager::instance()->unadvertiseService(proxy.name + each);
    }
  }

  /// Withdraws a service unless it is not ours.
  void giveWay(const std::string& service)
  {
    const std::lock_guard<std::mutex> turn(turn_lock_);
    const auto present = ros::ServiceManager::instance()->lookupServicePublication(service);
    if (present && present->getDataType().compare(0, 12, "dyknow_msgs/") == 0)
    {
      ros::ServiceManager::instance()->unadvertiseService(service);
    }
  }

  void announce(const std::string& nodelet)
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    if (sequence_ == announced_)
    {
      later([this] { tell(); }, std::max(Clock::now(), told_ + WINDOW));
    }
    changed_[nodelet] = ++sequence_;
  }

private:
  Services()
  {
    serve(poll_queue_);
    for (int i = 0; i < THREADS; ++i)
    {
      serve(queue_);
    }
  }

  void offerProcessInTurn()
  {
    advertise<PollEvent>(pollService(), [this](PollEvent& event) { return poll(event); }, poll_queue_);
  }

  void offerInTurn(const std::shared_ptr<NodeletProxy>& proxy)
  {
    const auto node = Registry::instance().node();
    const bool is_of_node = proxy == node || !isNodeletManager();
    if (is_of_node)
    {
      Guards::readRewirable();  // a nodelet manager's was read before
    }
    offerProcessInTurn();
    advertiseAll(proxy);
    proxy->is_offered = true;  // after its services: a manager that polls calls them
    if (is_of_node)
    {
      advertiseAll(node);  // it may load nodelets by itself: DyKnow managers find them by its services
      advertiseChanges();  // last: managers poll it at once
    }
  }

  /// Offers the services of a nodelet.
  void advertiseAll(const std::shared_ptr<NodeletProxy>& proxy)
  {
    advertise<GetConfigEvent>(proxy->name + "/get_config",
                              [proxy](GetConfigEvent& event) { return getConfig(*proxy, event); }, queue_);
    advertise<SetConfigEvent>(proxy->name + "/set_config",
                              [proxy](SetConfigEvent& event) { return setConfig(*proxy, event); }, queue_);
    advertise<GetStatisticsEvent>(proxy->name + "/get_statistics", [proxy](GetStatisticsEvent& event)
                                  { return getStatistics(*proxy, event); }, queue_);
  }

  /// Calls what is in a queue, on one more thread.
  static void serve(ros::CallbackQueue& queue)
  {
    // No ros::AsyncSpinner: it has a ros::NodeHandle, and wakes up ten times a second.
    std::thread(
        [&queue]
        {
          for (;;)
          {
            queue.callOne(ros::WallDuration(std::chrono::duration<double>(std::chrono::hours(1)).count()));
          }
        })
        .detach();
  }

  bool poll(PollEvent& event) const
  {
    const auto& request = event.getRequest();
    auto& answer = event.getResponse();
    if (request.topics.size() != request.nodelets.size())
    {
      return false;
    }
    for (const auto& guards : request.guards)
    {
      Guards::handOver(event.getCallerName(), guards);
    }
    if (request.duration > 0)
    {
      renewLease(request, event.getCallerName());
    }
    const bool is_manager = isNodeletManager();
    const std::set<std::string> counted(request.counted.begin(), request.counted.end());
    answer.changes = since(request.seen);
    for (const auto& [name, proxy] : offered())
    {
      if (is_manager && name == ros::this_node::getName())
      {
        continue;  // topics of its own
      }
      answer.nodelets.push_back(name);
      if (counted.count(name) > 0)
      {
        answer.counts.push_back(countsOf(*proxy));
      }
    }
    if (answer.nodelets.size() == 1 && !answer.counts.empty())
    {
      addProcess(answer.counts.front());
    }
    answer.machine = machine();
    answer.clock = Leases::clock();
    return true;
  }

  /// Publishes the topic unless it is; every new subscriber gets a message with all nodelets.
  void advertiseChanges()
  {
    if (!topics::isUp() || topics::publication(NODES))
    {
      return;
    }
    const auto greet = [this](const ros::SingleSubscriberPublisher& newcomer)
    {
      const auto changes = since(0);
      if (!changes.nodelets.empty())
      {
        newcomer.publish(changes);
      }
    };
    const ros::SubscriberStatusCallback none;
    const auto options = ros::AdvertiseOptions::create<dyknow_msgs::NodeletChanges>(
        NODES, QUEUE_SIZE, greet, none, ros::VoidConstPtr(), &poll_queue_);
    const topics::WiringLock lock;
    topics::advertise(
        lock, options,
        boost::make_shared<ros::SubscriberCallbacks>(greet, none, ros::VoidConstPtr(), &poll_queue_));
  }

  /// Offers a service unless it is.
  template <class Event, class Answer>
  void advertise(const std::string& name, Answer answer, ros::CallbackQueue& queue)
  {
    if (!topics::isUp() || ros::ServiceManager::instance()->lookupServicePublication(name))
    {
      return;
    }
    ros::AdvertiseServiceOptions options;
    options.initBySpecType<Event>(name, answer);
    options.callback_queue = &queue;
    ros::ServiceManager::instance()->advertiseService(options);
  }

  static std::map<std::string, std::shared_ptr<NodeletProxy>> offered()
  {
    std::map<std::string, std::shared_ptr<NodeletProxy>> found;
    for (const auto& each : Registry::instance().owners())
    {
      if (each->is_offered)
      {
        found[each->name] = each;
      }
    }
    return found;
  }

  /// All changes after one; those after 0 describe every nodelet.
  dyknow_msgs::NodeletChanges since(std::uint64_t sequence) const
  {
    dyknow_msgs::NodeletChanges changes;
    changes.process = ros::XMLRPCManager::instance()->getServerURI() + "@" + std::to_string(getpid());
    changes.kind = isNodeletManager() ? "cpp_nodelet" : "cpp_node";
    {
      std::lock_guard<std::mutex> lock(state_lock_);
      changes.sequence = sequence_;
      for (const auto& [name, number] : changed_)
      {
        if (number > sequence)
        {
          changes.nodelets.emplace_back();
          changes.nodelets.back().nodelet = name;
        }
      }
    }
    const auto present = offered();
    for (auto& each : changes.nodelets)
    {
      const auto found = present.find(each.nodelet);
      each.is_loaded = found != present.end();
      each.ports = each.is_loaded ? portsOf(*found->second) : each.ports;
      each.loader = each.is_loaded ? found->second->loader : each.loader;
      each.detail = stuckCallback(each.nodelet);
    }
    return changes;
  }

  void tell()
  {
    if (!topics::isUp())
    {
      return;  // after the next start, see offerEverything
    }
    std::uint64_t announced;
    {
      std::lock_guard<std::mutex> lock(state_lock_);
      announced = announced_;
    }
    const auto changes = since(announced);
    {
      std::lock_guard<std::mutex> lock(state_lock_);
      announced_ = changes.sequence;
      told_ = Clock::now();
      for (const auto& each : changes.nodelets)
      {
        if (!each.is_loaded && changed_[each.nodelet] <= announced_)
        {
          changed_.erase(each.nodelet);
        }
      }
      if (sequence_ > announced_)
      {
        later([this] { tell(); }, told_ + WINDOW);
      }
    }
    const auto publication = topics::publication(NODES);
    if (publication && !changes.nodelets.empty())
    {
      ros::SerializedMessage serialised;
      topics::publish(
          *publication, [&changes] { return ros::serialization::serializeMessage(changes); }, serialised);
    }
  }

  ros::CallbackQueue queue_;
  ros::CallbackQueue poll_queue_;  ///< waits for no set_config: leases run out meanwhile
  std::mutex turn_lock_;
  mutable std::mutex state_lock_;
  std::map<std::string, std::uint64_t> changed_;  ///< number of the last change of each nodelet
  std::uint64_t sequence_ = 0;
  std::uint64_t announced_ = 0;  ///< last change that was announced
  Clock::time_point told_;
};

}  // namespace

void offerServices(const std::shared_ptr<NodeletProxy>& proxy)
{
  if (!proxy->is_offered)
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

void giveWay(const std::string& service, const std::string& owner)
{
  const bool is_poll = service == pollService();
  if (is_poll || std::any_of(SERVICES.begin(), SERVICES.end(),
                             [&](const char* each) { return service == owner + each; }))
  {
    ROS_ERROR("%s: its own service '%s' has the name of one of DyKnow's, which cannot connect its ports then",
              owner.c_str(), service.c_str());
    Services::instance().giveWay(service);
    g_is_poll_taken = g_is_poll_taken || is_poll;
  }
}

bool isOwnService(const std::string& service)
{
  return service == pollService() && !g_is_poll_taken;
}

bool isOwnTopic(const std::string& topic)
{
  return topic == NODES;
}

void announceChange(const std::string& nodelet)
{
  Services::instance().announce(nodelet);
}

}  // namespace dyknow
