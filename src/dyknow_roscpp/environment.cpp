// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file LD_PRELOAD reaches every child of a process, and children of a node are not to be touched: the
/// library takes itself out of it once it is where it is to be.
///
/// It is loaded into the shells and wrappers (env, gdb, nice) before the node too, which have to pass it on.
/// They do not use libroscpp.
#include <dlfcn.h>
#include <link.h>

#include <cstdlib>
#include <map>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "symbols.h"

namespace dyknow
{
namespace
{

std::string fileName(const std::string& path)
{
  return path.substr(path.rfind('/') + 1);
}

/// Names of the libraries that a loaded object is linked with.
std::vector<std::string> neededBy(const link_map& object)
{
  const char* strings = nullptr;
  for (auto* each = object.l_ld; each->d_tag != DT_NULL; ++each)
  {
    if (each->d_tag == DT_STRTAB)
    {
      strings = reinterpret_cast<const char*>(each->d_un.d_ptr);
    }
  }
  std::vector<std::string> needed;
  for (auto* each = object.l_ld; strings != nullptr && each->d_tag != DT_NULL; ++each)
  {
    if (each->d_tag == DT_NEEDED)
    {
      needed.emplace_back(strings + each->d_un.d_val);
    }
  }
  return needed;
}

/// Whether the program is linked with libroscpp, other than through our library.
bool usesRoscpp(const std::string& ours)
{
  const link_map* program = nullptr;
  if (dlinfo(dlopen(nullptr, RTLD_LAZY), RTLD_DI_LINKMAP, &program) != 0)
  {
    return false;
  }
  std::map<std::string, const link_map*> loaded;
  for (const auto* each = program; each != nullptr; each = each->l_next)
  {
    loaded[fileName(each->l_name)] = each;
  }
  std::set<const link_map*> seen{program};
  std::vector<const link_map*> left{program};
  while (!left.empty())
  {
    const auto* object = left.back();
    left.pop_back();
    for (const auto& name : neededBy(*object))
    {
      if (name.compare(0, 12, "libroscpp.so") == 0)
      {
        return true;
      }
      const auto found = loaded.find(name);
      if (found != loaded.end() && name != ours && seen.insert(found->second).second)
      {
        left.push_back(found->second);
      }
    }
  }
  return false;
}

__attribute__((constructor)) void leaveEnvironment()
{
  const char* preloaded = std::getenv("LD_PRELOAD");
  const std::string ours = fileName(libraryOf(reinterpret_cast<void*>(&leaveEnvironment)));
  if (preloaded == nullptr || std::string(preloaded).find(ours) == std::string::npos || !usesRoscpp(ours))
  {
    return;
  }
  std::string text(preloaded);
  for (char& each : text)
  {
    each = each == ':' ? ' ' : each;  // the linker takes both
  }
  std::istringstream entries(text);
  std::string others;
  for (std::string entry; entries >> entry;)
  {
    if (fileName(entry) != ours)
    {
      others += (others.empty() ? "" : ":") + entry;
    }
  }
  if (others.empty())
  {
    unsetenv("LD_PRELOAD");
  }
  else
  {
    setenv("LD_PRELOAD", others.c_str(), 1);
  }
}

}  // namespace
}  // namespace dyknow
