// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "symbols.h"

#include <dlfcn.h>

#include <cstdio>
#include <cstdlib>

namespace dyknow
{

std::string symbolAt(const void* address)
{
  Dl_info info;
  return dladdr(address, &info) != 0 && info.dli_sname != nullptr ? info.dli_sname : "";
}

std::string libraryOf(const void* address)
{
  Dl_info info;
  return dladdr(address, &info) != 0 && info.dli_fname != nullptr ? info.dli_fname : "";
}

void* definitionBehind(const void* hook)
{
  const std::string symbol = symbolAt(hook);
  return symbol.empty() ? nullptr : dlsym(RTLD_NEXT, symbol.c_str());
}

void* requireBehind(const void* hook)
{
  void* found = definitionBehind(hook);
  if (found == nullptr)
  {
    std::fprintf(stderr, "dyknow: nothing behind %s defines %s\n", libraryOf(hook).c_str(),
                 symbolAt(hook).c_str());
    std::abort();
  }
  return found;
}

}  // namespace dyknow
