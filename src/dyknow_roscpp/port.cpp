// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "port.h"

#include <algorithm>

namespace dyknow
{

Port::Port(std::string label, Direction direction, std::string origin, std::string topic)
  : label(std::move(label))
  , direction(direction)
  , origin(std::move(origin))
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

std::shared_ptr<Traffic> Port::join(const std::shared_ptr<End>& end, const std::string& datatype)
{
  std::lock_guard<std::mutex> lock(state_lock_);
  if (datatype_.empty() || datatype_ == "*")
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
  shares_.push_back({end.get(), end, std::make_shared<Traffic>()});
  return shares_.back().traffic;
}

void Port::leave(const End* end)
{
  std::lock_guard<std::mutex> lock(state_lock_);
  for (auto& share : shares_)
  {
    if (share.key == end)
    {
      share.key = nullptr;
      share.end.reset();
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
  std::lock_guard<std::mutex> lock(state_lock_);
  Traffic::Snapshot sum;
  for (const auto& share : shares_)
  {
    const auto each = share.traffic->snapshot();
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
