// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file Which types of messages are one, see dyknow/datatypes.py.
#ifndef DYKNOW_ROSCPP_DATATYPES_H
#define DYKNOW_ROSCPP_DATATYPES_H

#include <string>

namespace dyknow
{

/// Whether two names stand for one type: their checksums are equal, as in roscpp's own comparison. Where one
/// cannot be had, because the type is not installed, the names are compared.
bool isSameType(const std::string& one, const std::string& other);

}  // namespace dyknow

#endif
