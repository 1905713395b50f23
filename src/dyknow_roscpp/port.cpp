// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "port.h"

#include <algorithm>

#include "names.h"

namespace dyknow
{

std::string topicBeside(const PortName& name, const std::string& image)
{
  if (image.empty())
  {
    return "";
  }
  const bool is_below = name.label.compare(0, name.image.size() + 1, name.image + "/") == 0;
  const std::string last = name.label.substr(name.label.find_last_of("/~") + 1);
  return names::join(is_below ? image : names::parent(image), last);
}

Port::Port(std::string owner, PortName name, Direction direction, std::string topic, std::string resolved)
  : owner(std::move(owner))
  , name(std::move(name))
  , direction(direction)
  , resolved(std::move(resolved))
  , topic_(std::move(topic))
{
}

std::string Port::topic() const
{
  std::lock_guard<std::mutex> lock(state_lock_);
  return topic_;
}

void Port::setTopic(const std::string& topic)
{
  std::lock_guard<std::mutex> lock(state_lock_);
  topic_ = topic;
}

std::string Port::datatype() const
{
  std::lock_guard<std::mutex> lock(state_lock_);
  return datatype_;
}

Traffic Port::join(const std::shared_ptr<End>& end, const std::string& datatype)
{
  std::lock_guard<std::mutex> lock(state_lock_);
  const bool is_alone =
      std::all_of(shares_.begin(), shares_.end(), [](const auto& share) { return share.end.expired(); });
  if (is_alone || datatype_ == "*")
  {
    datatype_ = datatype;
  }
  for (auto& share : shares_)
  {
    if (share.key == nullptr)
    {
      share.key = end.get();
      share.end = end;
      return share.traffic;
    }
  }
  shares_.push_back({end.get(), end, Traffic()});
  return Traffic();
}

void Port::leave(const End* end, const Traffic& traffic)
{
  std::lock_guard<std::mutex> lock(state_lock_);
  for (auto& share : shares_)
  {
    if (share.key == end)
    {
      share.key = nullptr;
      share.end.reset();
      share.traffic = traffic;
    }
  }
}

std::vector<std::shared_ptr<End>> Port::ends() const
{
  std::lock_guard<std::mutex> lock(state_lock_);
  std::vector<std::shared_ptr<End>> found;
  for (const auto& share : shares_)
  {
    if (auto end = share.end.lock())
    {
      found.push_back(std::move(end));
    }
  }
  return found;
}

Traffic::Snapshot Port::statistics() const
{
  std::vector<Share> shares;
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    shares = shares_;
  }
  Traffic::Snapshot sum;
  for (const auto& share : shares)
  {
    const auto end = share.end.lock();
    const auto each = (end ? end->traffic() : share.traffic).snapshot();
    if (each.messages > sum.messages)
    {
      sum.messages = each.messages;
      sum.rate = each.rate;
    }
    sum.dropped = std::max(sum.dropped, each.dropped);
    sum.busy += each.busy;
    sum.longest = std::max(sum.longest, each.longest);
  }
  return sum;
}

}  // namespace dyknow
