// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "leases.h"

#include <fcntl.h>
#include <netdb.h>
#include <poll.h>
#include <ros/network.h>
#include <ros/this_node.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <memory>
#include <thread>
#include <vector>

#include "dyknow_shared.h"
#include "names.h"
#include "registry.h"

namespace dyknow
{
namespace
{

constexpr std::chrono::milliseconds PERIOD(200);
/// For a connection to a manager's host, and for an answer.
constexpr int PATIENCE_MS = 400;

/// The topic in `producers` whose messages a topic carries, maybe in another form; empty if there is none.
std::string claimed(const Leases::Producers& producers, const std::string& topic)
{
  for (const auto& each : {topic, names::imageOf(topic)})
  {
    if (producers.count(each) > 0)
    {
      return each;
    }
  }
  return "";
}

/// Nodelets that publish messages of topics of claims, each with the topic of the claim.
std::set<std::pair<std::string, std::string>> publishing(const Leases::Producers& producers)
{
  std::set<std::pair<std::string, std::string>> found;
  for (const auto& proxy : Registry::instance().owners())
  {
    for (const auto& each : proxy->ports())
    {
      const std::string topic = claimed(producers, each.port->topic());
      if (each.port->direction == Direction::OUT && !topic.empty())
      {
        found.emplace(proxy->name, topic);
      }
    }
  }
  return found;
}

class Socket
{
public:
  explicit Socket(const addrinfo& address)
    : descriptor_(socket(address.ai_family, address.ai_socktype | SOCK_NONBLOCK | SOCK_CLOEXEC, 0))
  {
  }
  Socket(const Socket&) = delete;
  Socket& operator=(const Socket&) = delete;
  ~Socket() { close(descriptor_); }

  /// 0 once it is connected, ETIMEDOUT without an answer of the host, else the answer of the host.
  int connectTo(const addrinfo& address) const
  {
    if (connect(descriptor_, address.ai_addr, address.ai_addrlen) == 0)
    {
      return 0;
    }
    if (errno != EINPROGRESS)
    {
      return errno;
    }
    if (!waitFor(POLLOUT))
    {
      return ETIMEDOUT;
    }
    int error = 0;
    socklen_t size = sizeof(error);
    getsockopt(descriptor_, SOL_SOCKET, SO_ERROR, &error, &size);
    return error;
  }

  bool isAnswered(const std::string& question) const
  {
    char first = 0;
    return send(descriptor_, question.data(), question.size(), MSG_NOSIGNAL) > 0 && waitFor(POLLIN) &&
           recv(descriptor_, &first, 1, 0) == 1;
  }

private:
  bool waitFor(short events) const
  {
    pollfd waiting{descriptor_, events, 0};
    return poll(&waiting, 1, PATIENCE_MS) == 1;
  }

  const int descriptor_;
};

/// By how much a lease is extended: a manager's host answers, but the manager does not. It was killed or stopped.
double extensionFor(const std::string& uri)
{
  std::string host;
  std::uint32_t port = 0;
  if (!ros::network::splitURI(uri, host, port))
  {
    return 0.0;
  }
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found) != 0)
  {
    return 0.0;
  }
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> addresses(found, freeaddrinfo);
  const std::string body = "<?xml version='1.0'?><methodCall><methodName>getPid</methodName><params><param>"
                           "<value><string>" +
                           ros::this_node::getName() + "</string></value></param></params></methodCall>";
  double extension = 0.0;
  for (const addrinfo* each = found; each != nullptr; each = each->ai_next)
  {
    const Socket socket(*each);
    const int error = socket.connectTo(*each);
    if (error == 0)
    {
      const bool is_at_work = socket.isAnswered("POST /RPC2 HTTP/1.0\r\nHost: " + host +
                                                "\r\nContent-Type: text/xml\r\nContent-Length: " +
                                                std::to_string(body.size()) + "\r\n\r\n" + body);
      return is_at_work ? 0.0 : shared::LEASE_EXTENSION_STOPPED;
    }
    if (error == ETIMEDOUT)
    {
      return 0.0;  // at once, as the time is up
    }
    if (error == ECONNREFUSED || error == ECONNRESET)
    {
      extension = error == ECONNREFUSED ? shared::LEASE_EXTENSION_GONE : shared::LEASE_EXTENSION_STOPPED;
    }
  }
  return extension;
}

}  // namespace

Leases& Leases::instance()
{
  static Leases& leases = *new Leases;  // leaked, see later.cpp
  return leases;
}

double Leases::clock()
{
  timespec time{};
  clock_gettime(CLOCK_BOOTTIME, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

void Leases::renew(const std::string& manager, const std::string& uri, double confirmed, double duration,
                   const Producers& producers)
{
  const double moment = clock();
  if (moment > confirmed + shared::LEASE_PROBE_AFTER)  // of a manager that has gone, perhaps, while we stood
  {
    duration = std::min(duration, shared::LEASE_DURATION);
  }
  const auto present = publishing(producers);
  std::lock_guard<std::mutex> lock(state_lock_);
  const auto known = leases_.find(manager);
  if (producers.empty())
  {
    leases_.erase(manager);
  }
  else if (known != leases_.end() || confirmed > 0.0)
  {
    Lease lease{uri, confirmed + duration, 0.0, producers, {}};
    if (known != leases_.end())
    {
      const bool has_run_out = known->second.until < moment;  // replaced parts are among those that publish
      for (const auto& each : present)
      {
        const auto producer = producers.find(each.second);
        if (producer->second != each.first && (has_run_out || known->second.fenced.count(each) > 0))
        {
          lease.fenced.insert(each);
        }
      }
      lease.until = std::max(lease.until, std::min(known->second.until, moment + duration));
    }
    lease.probed_from = lease.until - duration + shared::LEASE_PROBE_AFTER;
    leases_[manager] = lease;
    if (!is_watched_)
    {
      is_watched_ = true;
      std::thread(&Leases::watch, this).detach();
    }
  }
  has_any_ = !leases_.empty();
}

bool Leases::mayPublishThere(const std::string& nodelet, const std::string& topic) const
{
  std::lock_guard<std::mutex> lock(state_lock_);
  return std::none_of(leases_.begin(), leases_.end(),
                      [&](const auto& each)
                      {
                        const Lease& lease = each.second;
                        const std::string claim = claimed(lease.producers, topic);
                        return !claim.empty() &&
                               (clock() > lease.until || lease.fenced.count({nodelet, claim}) > 0);
                      });
}

void Leases::watch()
{
  for (;;)
  {
    std::this_thread::sleep_for(PERIOD);
    std::map<std::string, std::string> due;
    const double moment = clock();
    {
      std::lock_guard<std::mutex> lock(state_lock_);
      for (const auto& each : leases_)
      {
        if (each.second.probed_from < moment && moment < each.second.until)
        {
          due.emplace(each.first, each.second.uri);
        }
      }
    }
    for (const auto& each : due)
    {
      const double extension = extensionFor(each.second);
      if (extension <= 0.0)
      {
        continue;
      }
      std::lock_guard<std::mutex> lock(state_lock_);
      const auto lease = leases_.find(each.first);
      if (lease != leases_.end() && lease->second.uri == each.second && clock() < lease->second.until)
      {
        lease->second.until = std::max(lease->second.until, moment + extension);
        lease->second.probed_from = moment + shared::LEASE_PROBE_AGAIN;
      }
    }
  }
}

}  // namespace dyknow
