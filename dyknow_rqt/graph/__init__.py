# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The graph that the window shows, and changes of it, as values; without Qt and ROS."""
