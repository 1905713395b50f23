// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "problems.h"

#include <algorithm>

#include "similar.h"

namespace dyknow
{
namespace
{

std::string joined(const std::vector<std::string>& texts, const std::string& separator)
{
  std::string all;
  for (const auto& text : texts)
  {
    all += (all.empty() ? "" : separator) + text;
  }
  return all;
}

}  // namespace

Refusal invalidName(const std::string& name, const std::string& what)
{
  return Refusal("'" + name + "' is not a valid " + what +
                 ": expected letters, digits, '_' and '/', starting with a letter, '/' or '~'");
}

Refusal typeMismatch(const std::string& topic, const std::string& wanted, const std::string& present)
{
  return Refusal("topic '" + topic + "' carries " + present + ", but " + wanted + " was asked for");
}

Refusal denied(const std::string& what, const std::string& why)
{
  return Refusal(what + " is denied: " + why);
}

Refusal protectedFromUnloading(const std::string& nodelet)
{
  return Refusal("nodelet '" + nodelet + "' is protected from unloading by its DyKnow manager; release it first: "
                 "dyknow unprotect " + nodelet);
}

Refusal limitExceeded(const std::string& what, std::size_t count, std::size_t limit)
{
  return Refusal("too many " + what + ": " + std::to_string(count) + ", at most " + std::to_string(limit) +
                 " are allowed");
}

Refusal unknownPort(const std::string& port, std::vector<std::string> known)
{
  std::sort(known.begin(), known.end());
  const std::string listed = known.empty() ? "none" : joined(known, ", ");
  return Refusal("unknown port '" + port + "'; known ports: " + listed + didYouMean(port, known));
}

Refusal duplicatePort(const std::string& port)
{
  return Refusal("port '" + port + "' is named twice or more; expected one topic for each port");
}

Refusal unloadedMeanwhile(const std::string& nodelet)
{
  return Refusal("nodelet '" + nodelet + "' was unloaded during its reconfiguration");
}

Refusal invalidConfiguration(const std::string& nodelet, const std::vector<std::string>& problems)
{
  return Refusal(nodelet + ": nothing was changed: " + joined(problems, "; "));
}

}  // namespace dyknow
