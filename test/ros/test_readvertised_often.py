#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Topics that come and go many times, at various intervals, reach all subscribers in the end."""

from __future__ import annotations

import random

import rospy
import rostest
from graph import set_config
from readvertised_suite import ReadvertisedCase

ROUNDS = 20
DOZES = (0.0, 0.0, 0.1, 0.7)  # s


class ReadvertisedOftenTest(ReadvertisedCase):
    def test_many_times(self):
        seed = random.randrange(1000)
        print(f"seed {seed}")
        dice = random.Random(seed)
        peers = [self.dozer(seconds) for seconds in DOZES]
        self.are_there(len(peers))
        self.is_heard_by(*peers)
        for _ in range(ROUNDS):
            for _ in range(3):
                if dice.random() < 0.5:
                    self.assertTrue(set_config("/talker", out="").success)
                    rospy.sleep(dice.choice((0.0, 0.0, 0.05, 0.3, 1.0)))
                    self.assertTrue(set_config("/talker", out="/t").success)
                else:
                    self.manager.unload("/talker")
                    rospy.sleep(dice.choice((0.0, 0.0, 0.05, 0.3, 1.0)))
                    self.load()
                for _ in range(dice.randrange(3)):
                    self.publish()
            self.is_heard_by(*peers)


if __name__ == "__main__":
    rospy.init_node("readvertised_often_test")
    rostest.rosrun("dyknow", "readvertised_often", "__main__")
