// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "registry.h"

#include <ros/names.h>
#include <ros/this_node.h>

#include <cstring>
#include <mutex>

#include "guards.h"
#include "process_services.h"

namespace dyknow
{
namespace
{

struct Works
{
  std::mutex state_lock;
  std::vector<RunningQueue::Work*> all;
};

Works& works()
{
  static auto& works = *new Works;  // leaked, see later.cpp
  return works;
}

thread_local RunningQueue::Work* t_work = nullptr;

/// The suffix that makes a topic the key of a handle, with a number of so many digits behind it: every message is
/// looked up by it.
constexpr char MARK[] = "/__dyknow";
constexpr std::size_t MARK_SIZE = sizeof(MARK) - 1;
constexpr std::size_t DIGITS = 8;
constexpr int BITS = 4;

/// The number of a key; 0 if it is none.
std::uint64_t numberOf(const std::string& key)
{
  if (key.size() < MARK_SIZE + DIGITS ||
      std::memcmp(key.data() + key.size() - MARK_SIZE - DIGITS, MARK, MARK_SIZE) != 0)
  {
    return 0;
  }
  std::uint64_t number = 0;
  for (const char* each = key.data() + key.size() - DIGITS; each != key.data() + key.size(); ++each)
  {
    number = number << BITS | static_cast<std::uint64_t>(*each - 'a');
  }
  return number;
}

std::string keyOf(const std::string& topic, std::uint64_t number)
{
  std::string key = topic + MARK;
  for (int shift = BITS * (DIGITS - 1); shift >= 0; shift -= BITS)
  {
    key += static_cast<char>('a' + (number >> shift & ((1U << BITS) - 1)));
  }
  return key;
}

/// The entry of a table for a key; null if none.
template <class End>
std::shared_ptr<End> find(const boost::container::flat_map<std::uint64_t, std::shared_ptr<End>>& table,
                          const std::string& key)
{
  const auto found = table.find(numberOf(key));
  return found == table.end() ? nullptr : found->second;
}

/// Same, and takes it out.
template <class End>
std::shared_ptr<End> extract(boost::container::flat_map<std::uint64_t, std::shared_ptr<End>>& table,
                             const std::string& key)
{
  auto found = find(table, key);
  table.erase(numberOf(key));
  return found;
}

}  // namespace

Registry& Registry::instance()
{
  static Registry& registry = *new Registry;  // leaked, see later.cpp
  return registry;
}

std::shared_ptr<NodeletProxy> Registry::enter(const std::string& nodelet,
                                              const std::map<std::string, std::string>& remappings,
                                              const std::vector<ros::CallbackQueueInterface*>& queues)
{
  std::unique_lock<std::shared_mutex> lock(state_lock_);
  auto& owner = owners_[nodelet];
  if (owner)
  {
    owner->add(remappings);
  }
  else
  {
    owner = std::make_shared<NodeletProxy>(nodelet, remappings, announceChange);
  }
  for (const auto* queue : queues)
  {
    if (queue != nullptr)
    {
      queues_[queue] = owner;
    }
  }
  return owner;
}

std::shared_ptr<NodeletProxy> Registry::leave(const ros::CallbackQueueInterface* queue)
{
  std::shared_ptr<NodeletProxy> gone;
  {
    std::unique_lock<std::shared_mutex> lock(state_lock_);
    const auto found = queues_.find(queue);
    if (found == queues_.end() || !isPresentLocked(found->second))
    {
      return nullptr;
    }
    gone = found->second;
    owners_.erase(gone->name);
  }
  gone->close();
  return gone;
}

std::string Registry::nodeletOf(const ros::CallbackQueueInterface* queue) const
{
  std::shared_lock<std::shared_mutex> lock(state_lock_);
  const auto found = queues_.find(queue);
  return found == queues_.end() || !isPresentLocked(found->second) ? "" : found->second->name;
}

bool Registry::isPresentLocked(const std::shared_ptr<NodeletProxy>& proxy) const
{
  const auto owner = owners_.find(proxy->name);
  return owner != owners_.end() && owner->second == proxy;
}

void Registry::forget(const ros::CallbackQueueInterface* queue)
{
  std::shared_ptr<NodeletProxy> gone;  // destroyed without the lock
  std::unique_lock<std::shared_mutex> lock(state_lock_);
  if (const auto found = queues_.find(queue); found != queues_.end())
  {
    gone.swap(found->second);
    queues_.erase(found);
  }
}

std::shared_ptr<NodeletProxy> Registry::ownerOf(const ros::NodeHandle& handle,
                                                const ros::CallbackQueueInterface* queue)
{
  {
    std::shared_lock<std::shared_mutex> lock(state_lock_);
    for (const auto* each : {queue, const_cast<const ros::CallbackQueueInterface*>(handle.getCallbackQueue()),
                             RunningQueue::current()})
    {
      const auto found = queues_.find(each);
      if (found != queues_.end())
      {
        return found->second;
      }
    }
  }
  return node();
}

std::shared_ptr<NodeletProxy> Registry::node()
{
  const std::string name = ros::this_node::getName();
  std::unique_lock<std::shared_mutex> lock(state_lock_);
  auto& found = owners_[name];
  if (!found)
  {
    found = std::make_shared<NodeletProxy>(name, ros::names::getRemappings(), announceChange);
    found->loader = Guards::starter();
  }
  return found;
}

std::vector<std::shared_ptr<NodeletProxy>> Registry::owners() const
{
  std::shared_lock<std::shared_mutex> lock(state_lock_);
  std::vector<std::shared_ptr<NodeletProxy>> found;
  for (const auto& each : owners_)
  {
    found.push_back(each.second);
  }
  return found;
}

std::string Registry::datatypeOf(const std::string& topic) const
{
  for (const auto& owner : owners())
  {
    for (const auto& each : owner->ports())
    {
      if (each.port->topic() == topic && each.port->datatype() != "*" && !each.port->ends().empty())
      {
        return each.port->datatype();
      }
    }
  }
  return "";
}

std::string Registry::makeKey(const std::string& topic)
{
  std::unique_lock<std::shared_mutex> lock(state_lock_);
  return keyOf(topic, ++last_number_);
}

bool Registry::isKey(const std::string& text)
{
  return numberOf(text) != 0;
}

std::string Registry::topicOf(const std::string& key)
{
  return isKey(key) ? key.substr(0, key.size() - MARK_SIZE - DIGITS) : key;
}

void Registry::add(const std::string& key, std::shared_ptr<PortSubscription> subscription)
{
  std::unique_lock<std::shared_mutex> lock(state_lock_);
  subscriptions_[numberOf(key)] = std::move(subscription);
}

void Registry::add(const std::string& key, std::shared_ptr<PortPublication> publication)
{
  std::unique_lock<std::shared_mutex> lock(state_lock_);
  publications_[numberOf(key)] = std::move(publication);
}

std::shared_ptr<PortSubscription> Registry::subscription(const std::string& key) const
{
  std::shared_lock<std::shared_mutex> lock(state_lock_);
  return find(subscriptions_, key);
}

std::shared_ptr<PortPublication> Registry::publication(const std::string& key) const
{
  std::shared_lock<std::shared_mutex> lock(state_lock_);
  return find(publications_, key);
}

void Registry::remove(const std::string& key)
{
  std::shared_ptr<PortSubscription> subscription;  // destroyed without the lock
  std::shared_ptr<PortPublication> publication;
  std::unique_lock<std::shared_mutex> lock(state_lock_);
  subscription = extract(subscriptions_, key);
  publication = extract(publications_, key);
}

RunningQueue::RunningQueue(const ros::CallbackQueueInterface* queue) : before_(current())
{
  if (t_work == nullptr)
  {
    t_work = new Work;
    std::lock_guard<std::mutex> lock(works().state_lock);
    works().all.push_back(t_work);
  }
  t_work->queue.store(queue, std::memory_order_relaxed);
  t_work->number.store(t_work->number.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
}

RunningQueue::~RunningQueue()
{
  t_work->queue.store(before_, std::memory_order_relaxed);
}

const ros::CallbackQueueInterface* RunningQueue::current()
{
  return t_work == nullptr ? nullptr : t_work->queue.load(std::memory_order_relaxed);
}

std::vector<RunningQueue::Work*> RunningQueue::all()
{
  std::lock_guard<std::mutex> lock(works().state_lock);
  return works().all;
}

}  // namespace dyknow
