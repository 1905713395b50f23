// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "names.h"

#include <algorithm>
#include <cctype>
#include <iterator>

#include "dyknow_shared.h"
#include "problems.h"

namespace dyknow::names
{
namespace
{

bool isLegal(const std::string& name)
{
  if (name.empty() || name == "~" || name == "/" || name == "~/" || name.find("//") != std::string::npos)
  {
    return false;
  }
  const unsigned char first = name[0];
  if (first > 127 || (std::isalpha(first) == 0 && first != '/' && first != '~'))
  {
    return false;
  }
  for (const unsigned char each : name.substr(1))
  {
    if (each > 127 || (std::isalnum(each) == 0 && each != '_' && each != '/'))
    {
      return false;
    }
  }
  return true;
}

std::string withoutEmptyParts(const std::string& name)
{
  std::string cleaned;
  for (const char each : name)
  {
    if (each != '/' || cleaned.empty() || cleaned.back() != '/')
    {
      cleaned += each;
    }
  }
  while (cleaned.size() > 1 && cleaned.back() == '/')
  {
    cleaned.pop_back();
  }
  return cleaned;
}

}  // namespace

std::string parent(const std::string& name)
{
  const auto slash = name.rfind('/');
  return slash == std::string::npos || slash == 0 ? "/" : name.substr(0, slash);
}

std::string join(const std::string& space, const std::string& name)
{
  return withoutEmptyParts(space + "/" + name);
}

bool isBelow(const std::string& name, const std::string& space)
{
  return space == "/" ? name.size() > 1
                      : name.size() > space.size() + 1 && name.compare(0, space.size(), space) == 0 &&
                            name[space.size()] == '/';
}

bool isDisconnected(const std::string& topic, const std::string& node)
{
  return isBelow(topic, join(node, "disconnected"));
}

std::string topicOf(const std::string& text, const std::string& node)
{
  if (!isLegal(text))
  {
    throw Refusal(shared::INVALID_NAME, {text, "topic name"});
  }
  if (text[0] == '/')
  {
    return withoutEmptyParts(text);
  }
  return text[0] == '~' ? join(node, text.substr(1)) : join(parent(node), text);
}

std::string beforeRemapping(const std::string& name, const std::map<std::string, std::string>& remappings)
{
  const std::pair<const std::string, std::string>* best = nullptr;
  for (const auto& each : remappings)
  {
    const bool applies = name == each.second || (each.second != "/" && isBelow(name, each.second));
    if (applies && (best == nullptr || each.second.size() > best->second.size()))
    {
      best = &each;
    }
  }
  return best == nullptr ? name : best->first + name.substr(best->second.size());
}

std::string portOf(const std::string& name, const std::string& node)
{
  if (isBelow(name, node))
  {
    return "~" + name.substr(node.size() + 1);
  }
  const std::string space = parent(node);
  return isBelow(name, space) ? name.substr(space == "/" ? 1 : space.size() + 1) : name;
}

std::string base(const std::string& port)
{
  return port.substr(std::min(port.find_first_not_of("~/"), port.size()));
}

std::string imageOf(const std::string& name)
{
  const auto slash = name.rfind('/');
  const auto& forms = shared::FORMS;
  const bool is_form = slash != std::string::npos && slash > 0 &&
                       std::count(std::begin(forms), std::end(forms), name.substr(slash + 1)) > 0;
  return is_form ? name.substr(0, slash) : "";
}

std::string globalOf(const std::string& port, const std::string& node)
{
  return port.empty() || port[0] == '/' ? port
         : port[0] == '~'               ? join(node, port.substr(1))
                                        : join(parent(node), port);
}

}  // namespace dyknow::names
