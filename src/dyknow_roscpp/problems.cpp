// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "problems.h"

#include <algorithm>
#include <functional>
#include <utility>

namespace dyknow
{
namespace
{

constexpr std::size_t MOST_SUGGESTIONS = 3;
constexpr double CUTOFF = 0.6;

/// Characters that two texts share: the longest common block, and those left and right of it.
std::size_t alike(const std::string& a, const std::string& b)
{
  std::size_t length = 0;
  std::size_t in_a = 0;
  std::size_t in_b = 0;
  std::vector<std::size_t> before(b.size() + 1, 0);
  for (std::size_t i = 0; i < a.size(); ++i)
  {
    std::vector<std::size_t> now(b.size() + 1, 0);
    for (std::size_t j = 0; j < b.size(); ++j)
    {
      now[j + 1] = a[i] == b[j] ? before[j] + 1 : 0;
      if (now[j + 1] > length)
      {
        length = now[j + 1];
        in_a = i + 1 - length;
        in_b = j + 1 - length;
      }
    }
    before.swap(now);
  }
  return length == 0 ? 0
                     : length + alike(a.substr(0, in_a), b.substr(0, in_b)) +
                           alike(a.substr(in_a + length), b.substr(in_b + length));
}

std::string filled(const std::string& text, const std::vector<std::string>& arguments)
{
  std::string all;
  for (std::size_t i = 0; i < text.size(); ++i)
  {
    const std::size_t argument = text[i] == '{' && i + 2 < text.size() ? text[i + 1] - '0' : arguments.size();
    if (argument < arguments.size())
    {
      all += arguments[argument];
      i += 2;
    }
    else
    {
      all += text[i];
    }
  }
  return all;
}

}  // namespace

Refusal::Refusal(const std::string& text, const std::vector<std::string>& arguments)
  : runtime_error(filled(text, arguments))
{
}

std::string joined(const std::vector<std::string>& texts, const std::string& separator)
{
  std::string all;
  for (const auto& text : texts)
  {
    all += (all.empty() ? "" : separator) + text;
  }
  return all;
}

std::string didYouMean(const std::string& name, const std::vector<std::string>& known)
{
  if (name.size() > shared::LONGEST_SUGGESTED)
  {
    return "";
  }
  const std::size_t reach = 3 + name.size() / 3;
  std::vector<std::pair<double, std::string>> similar;
  for (const auto& each : known)
  {
    if (each.size() > name.size() + reach || name.size() > each.size() + reach)
    {
      continue;
    }
    const double ratio = 2.0 * alike(each, name) / (each.size() + name.size());
    if (ratio >= CUTOFF)
    {
      similar.emplace_back(ratio, each);
    }
  }
  std::sort(similar.begin(), similar.end(), std::greater<>());
  std::string text;
  for (std::size_t i = 0; i < std::min(MOST_SUGGESTIONS, similar.size()); ++i)
  {
    text += (i == 0 ? "; did you mean " : " or ") + similar[i].second;
  }
  return text.empty() ? text : text + "?";
}

}  // namespace dyknow
