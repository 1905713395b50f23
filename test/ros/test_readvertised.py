#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A topic that is withdrawn and advertised again by the same process reaches its subscribers.

rospy's subscribers do not connect to an address to which they have a connection, and they do not
connect again when that connection turns out to be closed.
"""

from __future__ import annotations

import rospy
import rostest
from graph import nodes_on, set_config
from readvertised_suite import ReadvertisedCase

DOZE = 1.5  # s


class ReadvertisedTest(ReadvertisedCase):
    def dozing(self):
        """A peer that has just begun to doze over a message."""
        peer = self.dozer(DOZE)
        self.are_there(1)
        self.is_heard_by(peer)
        return peer

    def test_after_another_set_config(self):
        peer = self.dozing()
        self.assertTrue(set_config("/talker", out="").success)
        self.assertTrue(set_config("/talker", out="/t").success)
        self.is_heard_by(peer)

    def test_after_an_unload_and_a_load(self):
        peer = self.dozing()
        self.manager.unload("/talker")
        self.load()
        self.is_heard_by(peer)
        # A topic that is withdrawn for good stays so, even with notifications still pending.
        self.manager.unload("/talker")
        self.load()
        self.manager.unload("/talker")
        rospy.sleep(2.0)
        self.assertEqual(nodes_on("/t")[0], set())


if __name__ == "__main__":
    rospy.init_node("readvertised_test")
    rostest.rosrun("dyknow", "readvertised", "__main__")
