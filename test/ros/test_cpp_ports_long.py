#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ten thousand moves of live ports, in our nodelet manager and in the stock one."""

from __future__ import annotations

import rospy
import rostest
from cpp_suite import PRELOADED
from test_cpp_ports import MoveTest, UnloadTest


class ManyMovesTest(MoveTest):
    """In our nodelet manager."""


class ManyUnloadsTest(UnloadTest):
    """In our nodelet manager."""


class PreloadedTest(MoveTest):
    """In the stock nodelet manager, with the library preloaded."""

    command = PRELOADED


del MoveTest, UnloadTest  # they are run as they are in another suite

if __name__ == "__main__":
    rospy.init_node("cpp_ports_long_test")
    rostest.rosrun("dyknow", "cpp_ports_long", "__main__")
