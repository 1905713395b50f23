#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Everything is back after any end of everything."""

from __future__ import annotations

import random

import rospy
import rostest
from boot_suite import BootCase


class BootTest(BootCase):
    def test_everything_is_back(self):
        seed = rospy.get_param("~seed", 0) or random.randrange(10000)
        self.lives(rospy.get_param("~lives"), seed)


if __name__ == "__main__":
    rospy.init_node("boot_test")
    rostest.rosrun("dyknow", "boot", "__main__")
