#!/usr/bin/env python3
"""A topic that is withdrawn and advertised again by the same process is heard again.

rospy's subscribers do not connect to an address to which they have a connection, and they do not
connect again when that connection turns out to be closed.
"""

from __future__ import annotations

import itertools
import unittest

import rospy
import rostest
from graph import PEER, Manager, call, nodes_on, set_config
from processes import Running, eventually

DOZE = 1.5  # s


class ReadvertisedTest(unittest.TestCase):
    def setUp(self):
        self.manager = Manager("/manager")
        self.addCleanup(self.manager.__exit__)
        self.numbers = itertools.count(1)

    def peer(self, *arguments):
        peer = Running(*PEER, *arguments)
        self.addCleanup(peer.__exit__)
        return peer

    def publish(self):
        number = next(self.numbers)
        call("/talker", "publish", number, 1)
        return number

    def is_heard_by(self, *peers):
        """Publish until each peer has heard something new."""
        first = self.publish()

        def heard(peer):
            lines = [line.split() for line in peer.output.splitlines() if line.startswith("/t ")]
            return any(int(number) >= first for _, number in lines)

        def all_heard():
            self.publish()
            return all(map(heard, peers))

        eventually(all_heard, 8.0, "it is heard")

    def dozing(self):
        """A peer that has just begun to doze over a message."""
        self.manager.load("Talker", "/talker", {"/out": "/t"})
        peer = self.peer("doze", str(DOZE), "/t")
        eventually(lambda: nodes_on("/t")[1], 20.0, "it is there")
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
        self.manager.load("Talker", "/talker", {"/out": "/t"})
        self.is_heard_by(peer)
        # What was withdrawn for good stays withdrawn, whoever was to be told again.
        self.manager.unload("/talker")
        self.manager.load("Talker", "/talker", {"/out": "/t"})
        self.manager.unload("/talker")
        rospy.sleep(3 * DOZE)
        self.assertEqual(nodes_on("/t")[0], set())


if __name__ == "__main__":
    rospy.init_node("readvertised_test")
    rostest.rosrun("dyknow", "readvertised", "__main__")
