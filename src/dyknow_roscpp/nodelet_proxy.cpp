// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "nodelet_proxy.h"

#include <ros/console.h>

#include <algorithm>
#include <stdexcept>
#include <thread>

#include "guards.h"
#include "later.h"
#include "master.h"
#include "names.h"
#include "problems.h"
#include "registry.h"

namespace dyknow
{
namespace
{

/// How long a reconfiguration waits for peers outside.
constexpr std::chrono::milliseconds PEERS_PATIENCE(500);
/// How long it waits for another reconfiguration of the nodelet.
constexpr std::chrono::milliseconds TURN_PATIENCE(2000);
constexpr std::chrono::milliseconds PEERS_STEP(1);

/// Moves that are prepared, and cancelled unless they are committed.
class Preparation
{
public:
  ~Preparation()
  {
    for (const auto& end : ends_)
    {
      end->cancel();
    }
  }

  void add(const std::shared_ptr<End>& end, const std::string& topic, Clock::time_point deadline,
           const OutTopics& outs)
  {
    ends_.insert(ends_.begin(), end);  // first: it may have registered when it raises
    end->prepare(topic, deadline, outs);
  }

  /// @param announcement null: nothing is to be announced
  void commit(const AnnouncementPtr& announcement)
  {
    bool is_announced = false;
    for (const auto& end : ends_)
    {
      end->makeWay();
    }
    for (const auto& end : ends_)
    {
      is_announced = end->commit(announcement) || is_announced;
    }
    ends_.clear();
    if (announcement && !is_announced)
    {
      announcement->make();
    }
  }

private:
  std::vector<std::shared_ptr<End>> ends_;  ///< the last one that was added comes first
};

/// Whether the port of a change is this one; one to come may have come meanwhile, by another of its names.
bool isSame(const std::shared_ptr<Port>& changed, const std::shared_ptr<Port>& port)
{
  return changed == port || (changed->resolved.empty() && changed->name.origin == port->name.origin);
}

}  // namespace

NodeletProxy::NodeletProxy(std::string name, std::map<std::string, std::string> remappings,
                           std::function<void(const std::string&)> on_change)
  : name(std::move(name))
  , on_change_(std::move(on_change))
  , remappings_(std::move(remappings))
{
}

std::map<std::string, std::string> NodeletProxy::remappings() const
{
  std::lock_guard<std::mutex> lock(state_lock_);
  return remappings_;
}

void NodeletProxy::add(const std::map<std::string, std::string>& remappings)
{
  std::lock_guard<std::mutex> lock(state_lock_);
  remappings_.insert(remappings.begin(), remappings.end());
}

std::shared_ptr<Port> NodeletProxy::declare(const PortName& port_name, Direction direction,
                                            const std::string& topic)
{
  const auto known = this->ports();
  const auto is_called = [this, direction](const Port& port, const std::string& label)
  {
    // Of one to come, neither the direction nor how the code will call its topic is known.
    return port.resolved.empty() ? port.name.origin == names::globalOf(label, name)
                                 : port.name.label == label && port.direction == direction;
  };
  const auto find = [&known, &is_called](const std::string& label)
  {
    return std::find_if(known.begin(), known.end(),
                        [&label, &is_called](const auto& each) { return is_called(*each.port, label); });
  };
  std::string first = topicAtStart(topic);
  // What image_transport puts beside an image goes where that was moved, unless the load puts it elsewhere.
  if (const auto image = find(port_name.image);
      image != known.end() &&
      (image->port->resolved.empty() || first == topicBeside(port_name, topicAtStart(image->port->resolved))))
  {
    first = topicBeside(port_name, image->port->topic());
  }
  else if (image == known.end() && direction == Direction::IN && !port_name.image.empty() &&
           first == port_name.origin)
  {
    // image_transport subscribes to a form of an image by its own name; the load remaps that of the image.
    const auto remappings = this->remappings();
    if (const auto given = remappings.find(names::globalOf(port_name.image, name)); given != remappings.end())
    {
      first = topicBeside(port_name, topicAtStart(given->second));
    }
  }
  if (find(port_name.label) == known.end())
  {
    first = Guards::permitted(first, name);
  }
  std::shared_ptr<Port> port;
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    for (auto each = ports_.begin(); each != ports_.end(); ++each)
    {
      const auto& known = **each;
      if (!is_called(known, port_name.label))
      {
        continue;
      }
      if (!known.resolved.empty())
      {
        return *each;
      }
      first = known.topic();  // now it has come
      ports_.erase(each);
      break;
    }
    port = std::make_shared<Port>(name, port_name, direction, first, topic);
    ports_.push_back(port);
  }
  on_change_(name);
  return port;
}

std::vector<NodeletProxy::NamedPort> NodeletProxy::ports() const
{
  std::lock_guard<std::mutex> lock(state_lock_);
  std::vector<NamedPort> named;
  for (const auto& port : ports_)
  {
    // A topic that is used in both directions is two ports.
    const bool is_one_of_two =
        std::any_of(ports_.begin(), ports_.end(),
                    [&port](const auto& other)
                    { return other->name.label == port->name.label && other->direction != port->direction; });
    const std::string suffix = is_one_of_two ? port->direction == Direction::IN ? "_in" : "_out" : "";
    named.push_back({port->name.label + suffix, port});
  }
  return named;
}

std::uint32_t NodeletProxy::reconfigurations() const
{
  std::lock_guard<std::mutex> lock(state_lock_);
  return reconfigurations_;
}

void NodeletProxy::setConfig(const Config& config, const std::string& caller)
{
  const std::unique_lock<std::timed_mutex> turn(turn_lock_, forWaiting(Clock::now() + TURN_PATIENCE));
  if (!turn)
  {
    throw Refusal("another reconfiguration of '" + name + "' takes too long; try again");
  }
  const auto guards = Guards::current();
  const std::string what = "connecting ports of '" + name + "'";
  Guards::checkRewirable(what);
  guards.checkCaller(caller, what);
  std::vector<std::string> texts;
  for (const auto& [port, topic] : config)
  {
    texts.push_back(port);
    texts.push_back(topic);
  }
  guards.checkSizes(texts, config.size());
  const MasterState master(Clock::now() + MASTER_PATIENCE);
  const auto changes = checked(config, guards, master);
  if (std::any_of(changes.begin(), changes.end(),
                  [](const auto& each) { return each.port->topic() != each.topic; }))
  {
    master.requireAnswer();
    apply(changes);
    on_change_(name);
  }
}

void NodeletProxy::close()
{
  std::lock_guard<std::mutex> lock(state_lock_);
  is_closed_ = true;
  listener->close();
}

std::vector<NodeletProxy::Change> NodeletProxy::checked(const Config& config, const Guards& guards,
                                                        const MasterState& master) const
{
  const auto ports = this->ports();
  std::vector<std::string> problems;
  std::vector<Change> changes;
  std::map<std::string, std::string> types;
  std::map<std::string, int> named;
  const auto is_changed = [&changes](const std::shared_ptr<Port>& port)
  {
    return std::any_of(changes.begin(), changes.end(),
                       [&port](const auto& each) { return isSame(each.port, port); });
  };
  const auto change = [&](const NamedPort& port, const std::string& topic)
  {
    if (!topic.empty())
    {
      guards.checkTopic(topic);
      checkType(port, topic, master, types);
    }
    changes.push_back({port.port, topic});
  };
  for (const auto& entry : config)
  {
    if (++named[entry.first] == 2)
    {
      problems.push_back(Refusal(shared::DUPLICATE_PORT, {entry.first}).what());
    }
  }
  for (const auto& [text, wanted] : config)
  {
    try
    {
      const auto found = find(text, ports);
      const std::string topic = wanted.empty() ? "" : names::topicOf(wanted, name);
      for (const auto& port : found)
      {
        const bool is_beside = names::globalOf(port->name.image, name) == names::globalOf(text, name);
        if (is_beside && named.count(port->name.label) + named.count(port->name.origin) > 0)
        {
          continue;  // it has an entry of its own
        }
        if (is_changed(port) && named[text] == 1)  // by both of its names
        {
          throw Refusal(shared::DUPLICATE_PORT, {text});
        }
        change({text, port}, is_beside ? topicBeside(port->name, topic) : topic);
      }
    }
    catch (const Refusal& problem)
    {
      problems.push_back(problem.what());
    }
  }
  // What image_transport put beside an image, and is still there, goes with it.
  for (const auto& [moved, topic] : std::vector<Change>(changes))
  {
    for (const auto& each : ports)
    {
      const auto& port = each.port;
      if (names::globalOf(port->name.image, name) == moved->name.origin &&
          port->direction == moved->direction && !is_changed(port) &&
          port->topic() == topicBeside(port->name, moved->topic()))
      {
        try
        {
          change(each, topicBeside(port->name, topic));
        }
        catch (const Refusal& problem)
        {
          problems.push_back(problem.what());
        }
      }
    }
  }
  if (!problems.empty())
  {
    throw Refusal(shared::INVALID_CONFIGURATION, {name, joined(problems, "; ")});
  }
  return changes;
}

std::vector<std::shared_ptr<Port>> NodeletProxy::find(const std::string& text,
                                                      const std::vector<NamedPort>& ports) const
{
  const std::string origin = names::globalOf(text, name);
  std::vector<std::string> known;
  std::vector<std::shared_ptr<Port>> by_origin;
  std::vector<std::shared_ptr<Port>> by_image;  // of an image that comes by image_transport's topics alone
  for (const auto& each : ports)
  {
    if (each.name == text)
    {
      return {each.port};
    }
    if (each.port->name.origin == origin)
    {
      by_origin.push_back(each.port);
    }
    if (!text.empty() && names::globalOf(each.port->name.image, name) == origin)
    {
      by_image.push_back(each.port);
    }
    known.push_back(each.name);
  }
  if (by_origin.empty() && !by_image.empty())
  {
    return by_image;
  }
  if (by_origin.empty())
  {
    by_origin.push_back(portToCome(origin, ports));
  }
  if (by_origin.size() != 1 || !by_origin.front())  // of two it cannot say which
  {
    std::sort(known.begin(), known.end());
    throw Refusal(shared::UNKNOWN_PORT, {text, known.empty() ? "none" : joined(known, ", ") + didYouMean(text, known)});
  }
  return by_origin;
}

std::shared_ptr<Port> NodeletProxy::portToCome(const std::string& origin,
                                               const std::vector<NamedPort>& ports) const
{
  const auto remappings = this->remappings();
  const auto remapping = remappings.find(origin);
  if (remapping == remappings.end())
  {
    return nullptr;
  }
  const PortName port_name{names::portOf(origin, name), origin, ""};
  // Misspelt, `out` for `~out`: no load names that. Code that watches the subscribers of `~image` may
  // subscribe to `image` then.
  const auto is_meant = [&](const auto& each)
  {
    return names::base(each.port->name.label) == names::base(port_name.label) &&
           remappings.count(each.port->name.origin) == 0 && !each.port->is_watched;
  };
  if (std::any_of(ports.begin(), ports.end(), is_meant))
  {
    return nullptr;
  }
  // Of which direction it will be is not known; usually the subscription is lazy.
  return std::make_shared<Port>(name, port_name, Direction::IN, topicAtStart(remapping->second));
}

std::string NodeletProxy::topicAtStart(const std::string& remapped) const
{
  return names::isDisconnected(remapped, name) ? "" : remapped;
}

void NodeletProxy::checkType(const NamedPort& port, const std::string& topic, const MasterState& master,
                             std::map<std::string, std::string>& types) const
{
  const std::string wanted = port.port->datatype();
  if (wanted.empty() || wanted == "*")
  {
    return;
  }
  // The type of a topic: of its live ports, or of the first port to come.
  if (types.count(topic) == 0 && topic != port.port->topic())
  {
    const std::string here = Registry::instance().datatypeOf(topic);
    types[topic] = here.empty() ? master.datatypeOf(topic) : here;
  }
  auto& present = types[topic];
  if (present.empty())
  {
    present = wanted;
  }
  if (!isSameType(present, wanted))
  {
    throw Refusal(shared::TYPE_MISMATCH, {topic, wanted + " (port '" + port.name + "')", present});
  }
}

void NodeletProxy::setTopicsLocked(std::vector<Change>& changes)
{
  for (auto& change : changes)
  {
    const auto known = std::find_if(ports_.begin(), ports_.end(),
                                    [&change](const auto& each) { return isSame(change.port, each); });
    if (known == ports_.end())
    {
      ports_.push_back(change.port);  // one to come
    }
    else
    {
      change.port = *known;  // which may have come meanwhile
    }
    change.port->setTopic(change.topic);
  }
}

void NodeletProxy::apply(std::vector<Change> changes)
{
  const auto deadline = Clock::now() + PEERS_PATIENCE;
  Preparation preparation;
  std::vector<std::shared_ptr<End>> prepared;
  OutTopics outs;
  for (const auto& change : changes)
  {
    if (change.port->direction == Direction::OUT && change.port->topic() != change.topic)
    {
      outs.left.insert(change.port->topic());
      outs.come.insert(change.topic);
    }
  }
  // Subscriptions first, which then know what not to hear; publications are committed before them.
  for (const auto direction : {Direction::IN, Direction::OUT})
  {
    for (const auto& change : changes)
    {
      if (change.port->direction != direction || change.port->topic() == change.topic)
      {
        continue;
      }
      for (const auto& end : change.port->ends())
      {
        try
        {
          preparation.add(end, change.topic, deadline, outs);
        }
        catch (const std::runtime_error& error)  // of roscpp, or a Refusal
        {
          throw Refusal(shared::INVALID_CONFIGURATION, {name, error.what()});
        }
        prepared.push_back(end);
      }
    }
  }
  const auto is_ready = [](const auto& end)
  {
    return end->isReady();
  };
  while (Clock::now() < deadline && !std::all_of(prepared.begin(), prepared.end(), is_ready))
  {
    std::this_thread::sleep_for(PEERS_STEP);  // a poll: roscpp reports a subscriber, but not of all of them
  }
  PortMaps maps;
  {
    std::lock_guard<std::mutex> lock(state_lock_);
    if (is_closed_)
    {
      throw Refusal(shared::UNLOADED_MEANWHILE, {name});
    }
    setTopicsLocked(changes);
    maps.change = ++reconfigurations_;
  }
  for (const auto& each : ports())
  {
    (each.port->direction == Direction::IN ? maps.inputs : maps.outputs)[each.name] = each.port->topic();
  }
  preparation.commit(listener->isSet() ? std::make_shared<Announcement>(listener, std::move(maps)) : nullptr);
  followPorts(changes);
}

void NodeletProxy::followPorts(const std::vector<Change>& changes)
{
  // A handle that was made meanwhile is where its port was.
  for (const auto& change : changes)
  {
    for (const auto& end : change.port->ends())
    {
      if (end->isOpen() && end->topic() != change.topic)
      {
        try
        {
          end->prepare(change.topic, Clock::now() + PEERS_PATIENCE, {});
          end->commit(nullptr);
        }
        catch (const std::exception& error)  // the others have moved, and stay
        {
          ROS_ERROR("%s: a new handle of port '%s' is not on '%s': %s", name.c_str(),
                    change.port->name.label.c_str(), change.topic.c_str(), error.what());
          end->cancel();
        }
      }
    }
  }
}

}  // namespace dyknow
