# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Plain values for everything that crosses a seam: transformations, nodelets and streams.

The manager answers with these values, the messages of ``dyknow_msgs`` carry them, and the command
line, wirings and the window work on them. Nothing here knows ROS.
"""
