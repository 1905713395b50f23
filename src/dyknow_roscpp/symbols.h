// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The look-up of functions in the libraries behind this one.
///
/// Functions of libroscpp are called through the procedure linkage table, so a library that comes first in
/// the look-up order takes their place: an executable that is linked with it first, or one that is started
/// with LD_PRELOAD. A hook is a definition of such a function; `behind` finds the one that it stands in front
/// of.
#ifndef DYKNOW_ROSCPP_SYMBOLS_H
#define DYKNOW_ROSCPP_SYMBOLS_H

#include <cstring>
#include <string>
#include <utility>

namespace dyknow
{

/// Linker's name of the function at an address; empty if it has none.
std::string symbolAt(const void* address);

/// File of the library that has a function.
std::string libraryOf(const void* address);

/// The next definition of a function of ours in the look-up order; null if there is none.
void* definitionBehind(const void* hook);

/// Same; ends the process with the symbol's name if there is none, since the call cannot be passed on.
void* requireBehind(const void* hook);

/// Address of a function that is a non-virtual method.
template <class Method>
void* addressOf(Method method)
{
  void* address;
  static_assert(sizeof(method) >= sizeof(address));
  std::memcpy(&address, &method, sizeof(address));  // so it is laid out by the Itanium C++ ABI
  return address;
}

/// The function behind a hook that is a method, to be called with the object first.
template <class Result, class Class, class... Arguments>
auto behind(Result (Class::*hook)(Arguments...))
{
  return reinterpret_cast<Result (*)(Class*, Arguments...)>(requireBehind(addressOf(hook)));
}

/// Same, for a function that is no method.
template <class Result, class... Arguments>
auto behind(Result (*hook)(Arguments...))
{
  return reinterpret_cast<Result (*)(Arguments...)>(requireBehind(reinterpret_cast<void*>(hook)));
}

/// Same, for a method that is const.
template <class Result, class Class, class... Arguments>
auto behind(Result (Class::*hook)(Arguments...) const)
{
  return reinterpret_cast<Result (*)(const Class*, Arguments...)>(requireBehind(addressOf(hook)));
}

/// Access to private members of roscpp's classes: an explicit instantiation may name one, and defines a friend that
/// returns the pointer to it.
template <class Tag, typename Tag::Member pointer>
struct PrivateMember
{
  friend typename Tag::Member pointerTo(Tag) { return pointer; }
};

/// Same, for a method of which only the address is wanted.
template <class Tag, typename Tag::Method method>
struct PrivateMethod
{
  friend void* addressOfPrivate(Tag) { return addressOf(method); }
};

/// Sets a variable of this thread while it lives.
template <class Value>
class Setting
{
public:
  Setting(Value& variable, Value value) : variable_(variable), before_(std::exchange(variable, value)) {}
  ~Setting() { variable_ = before_; }
  Setting(const Setting&) = delete;
  Setting& operator=(const Setting&) = delete;

private:
  Value& variable_;
  const Value before_;
};

}  // namespace dyknow

#endif
