// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Access to private members of roscpp's classes, whose headers are not ours to change.
///
/// An explicit instantiation may name a private member; it defines a friend that returns the pointer to it.
#ifndef DYKNOW_ROSCPP_PRIVATE_MEMBER_H
#define DYKNOW_ROSCPP_PRIVATE_MEMBER_H

#include "symbols.h"

namespace dyknow
{

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

}  // namespace dyknow

#endif
