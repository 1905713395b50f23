# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

# Whoever depends on dyknow gets its messages too: dyknow_msgs is nested in this package, where no crawl finds it.
find_package(dyknow_msgs REQUIRED)
list(APPEND dyknow_INCLUDE_DIRS ${dyknow_msgs_INCLUDE_DIRS})
list(APPEND dyknow_EXPORTED_TARGETS ${dyknow_msgs_EXPORTED_TARGETS})
