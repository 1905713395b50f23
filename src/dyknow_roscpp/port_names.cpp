// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "port_names.h"

#include <ros/names.h>

#include <algorithm>
#include <mutex>
#include <utility>
#include <vector>

#include "names.h"

namespace dyknow
{
namespace
{

/// Names of one owner that are kept at most.
constexpr std::size_t MOST_NAMES = 1000;

std::map<std::string, std::string> remappingsOf(const NodeletProxy& owner)
{
  auto all = owner.remappings();
  for (const auto& each : ros::names::getRemappings())
  {
    all.insert(each);
  }
  return all;
}

/// The port of a name that is relative to a handle.
PortName relativePort(const NodeletProxy& owner, const ros::NodeHandle& handle, const std::string& name)
{
  std::string space = handle.getNamespace();
  if (space != owner.name && space != names::parent(owner.name))
  {
    space = names::beforeRemapping(space, remappingsOf(owner));
  }
  const std::string origin = names::join(space, name);
  const std::string label = names::portOf(origin, owner.name);
  return {label, origin, names::imageOf(label)};
}

/// The label of a port that the code calls by a global name.
std::string globalLabel(const NodeletProxy& owner, const std::string& topic)
{
  return names::isBelow(topic, owner.name) ? names::portOf(topic, owner.name) : topic;
}

/// The port of a resolved name on which no handle is open; its label is empty if there is none.
PortName leftPort(const std::vector<NodeletProxy::NamedPort>& ports, const std::string& resolved,
                  Direction direction)
{
  PortName left;
  for (const auto& [name, port] : ports)
  {
    if (port->direction == direction && port->resolved == resolved && port->ends().empty() &&
        (left.label.empty() || port->name.origin == resolved))
    {
      left = port->name;
    }
  }
  return left;
}

/// The port of a resolved name that was left or noted; its label is empty if there is none.
PortName knownPort(NodeletProxy& owner, const std::string& resolved, Direction direction)
{
  auto ports = owner.ports();
  const auto left = leftPort(ports, resolved, direction);
  std::lock_guard<std::mutex> lock(owner.noted_lock);
  const auto& noted = owner.noted;
  if (const auto found = noted.find(resolved); found != noted.end())
  {
    return {found->second, names::globalOf(found->second, owner.name), ""};
  }
  if (!left.label.empty())
  {
    return left;
  }
  // image_transport puts a transport's topic below that of the image, and the camera's beside it.
  const auto last = resolved.rfind('/') + 1;
  const std::string space = names::parent(resolved);
  const bool is_info = resolved.compare(last, std::string::npos, "camera_info") == 0;
  // A global name may be that of a camera's namespace.
  if (const auto found = noted.find(space); found != noted.end() && !(is_info && found->second[0] == '/'))
  {
    const std::string label = found->second + "/" + resolved.substr(last);
    return {label, names::globalOf(label, owner.name), found->second};
  }
  // The handle of the image, or of a transport of it, has been made just before that of its camera_info.
  std::reverse(ports.begin(), ports.end());
  for (const auto& [name, port] : ports)
  {
    const auto& label = port->name.image.empty() ? port->name.label : port->name.image;
    const auto is_beside = [&label, &space](const auto& each)
    {
      return each.second == label && names::parent(each.first) == space;
    };
    if (is_info && port->direction == direction && std::any_of(noted.begin(), noted.end(), is_beside))
    {
      const auto slash = label.rfind('/');
      const std::string before = slash != std::string::npos ? label.substr(0, slash + 1)
                                 : label[0] == '~'          ? "~"
                                                            : "";
      const std::string beside = before + "camera_info";
      return {beside, names::globalOf(beside, owner.name), label};
    }
  }
  return {};
}

}  // namespace

PortName namePort(NodeletProxy& owner, const ros::NodeHandle& handle, const std::string& topic,
                  Direction direction)
{
  if (topic.empty() || topic[0] != '/')
  {
    return relativePort(owner, handle, topic);
  }
  const auto known = knownPort(owner, topic, direction);
  if (!known.label.empty())
  {
    return known;
  }
  const std::string label = globalLabel(owner, topic);
  return {label, topic, names::imageOf(label)};
}

void noteResolved(NodeletProxy& owner, const ros::NodeHandle& handle, const std::string& asked,
                  const std::string& resolved)
{
  const bool is_global = asked[0] == '/';
  const std::string clean = names::join("/", asked);
  const auto label = is_global ? globalLabel(owner, clean) : relativePort(owner, handle, asked).label;
  if (is_global && clean == resolved)
  {
    const auto ports = owner.ports();
    const auto is_here = [&resolved](const auto& each)
    {
      return each.port->resolved == resolved;
    };
    // It may be the name of a namespace, or the topic of a handle that the code asks for.
    if (names::isBelow(names::join(owner.name, "any"), resolved) ||
        std::any_of(ports.begin(), ports.end(), is_here))
    {
      return;
    }
  }
  std::lock_guard<std::mutex> lock(owner.noted_lock);
  auto& noted = owner.noted;
  const auto found = noted.find(resolved);
  // image_transport resolves what its caller has resolved, whose name stays.
  const bool is_free = !is_global || found == noted.end() || (found->second[0] == '/' && clean != resolved);
  if (is_free && noted.size() < MOST_NAMES)
  {
    noted[resolved] = label;
  }
}

}  // namespace dyknow
