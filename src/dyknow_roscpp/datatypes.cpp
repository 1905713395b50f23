// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "datatypes.h"

#include <cstdlib>
#include <fstream>
#include <regex>
#include <sstream>

namespace dyknow
{
namespace
{

/// Where Debian has the modules of its ROS packages, which no set-up file adds to PYTHONPATH.
constexpr const char* SYSTEM_MODULES = "/usr/lib/python3/dist-packages";

/// The checksum of a type, from the Python module that is generated for every message; else its name.
std::string canonical(const std::string& datatype)
{
  static const std::regex name("([A-Za-z]\\w*)/([A-Za-z]\\w*)");
  static const std::regex checksum("\\s*_md5sum = \"([0-9a-f]{32})\"");
  std::smatch match;
  if (!std::regex_match(datatype, match, name))
  {
    return datatype;
  }
  const char* modules = std::getenv("PYTHONPATH");
  std::istringstream folders(std::string(modules == nullptr ? "" : modules) + ":" + SYSTEM_MODULES);
  for (std::string folder; std::getline(folders, folder, ':');)
  {
    std::ifstream module(folder + "/" + match.str(1) + "/msg/_" + match.str(2) + ".py");
    for (std::string line; std::getline(module, line);)
    {
      std::smatch found;
      if (line.size() < 100 && std::regex_match(line, found, checksum))
      {
        return found.str(1);
      }
    }
  }
  return datatype;
}

}  // namespace

bool isSameType(const std::string& one, const std::string& other)
{
  return one == other || canonical(one) == canonical(other);
}

}  // namespace dyknow
