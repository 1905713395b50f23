#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A topic that is withdrawn and advertised again by the same process reaches its subscribers.

rospy's subscribers do not connect to an address to which they have a connection, and they do not
connect again when that connection turns out to be closed.
"""

from __future__ import annotations

import itertools
import random
import unittest

import rospy
import rostest
from graph import PEER, Manager, call, nodes_on, set_config
from processes import Running, eventually

DOZE = 1.5  # s
DOZES = (0.0, 0.0, 0.1, 0.7)  # s


class ReadvertisedCase(unittest.TestCase):
    """Each test has a talker on /t in its own nodelet manager."""

    def setUp(self):
        self.manager = Manager("/manager")
        self.addCleanup(self.manager.__exit__)
        self.numbers = itertools.count(1)
        self.load()

    def load(self):
        self.manager.load("Talker", "/talker", {"/out": "/t"})

    def dozer(self, seconds):
        """A peer that sleeps for a time (s) after each message."""
        peer = Running(*PEER, "doze", str(seconds), "/t")
        self.addCleanup(peer.__exit__)
        return peer

    def are_there(self, count):
        """Wait for a number of peers."""
        eventually(lambda: len(nodes_on("/t")[1]) == count, 20.0, "they are there")

    def publish(self):
        number = next(self.numbers)
        call("/talker", "publish", number, 1)
        return number

    def is_heard_by(self, *peers):
        """Publish until each peer has heard something new."""
        first = self.publish()

        def heard(peer):
            lines = [line.split() for line in peer.output.splitlines() if line.startswith("/t ")]
            return any(int(number) >= first for _, number in lines[-1:])

        def all_heard():
            self.publish()
            return all(map(heard, peers))

        eventually(
            all_heard, 8.0, f"{first} is heard", lambda: [peer.output[-60:] for peer in peers]
        )


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


class OftenTest(ReadvertisedCase):
    """Many times, at various intervals; only in the long run."""

    def test_many_times(self):
        seed = random.randrange(1000)
        print(f"seed {seed}")
        dice = random.Random(seed)
        peers = [self.dozer(seconds) for seconds in DOZES]
        self.are_there(len(peers))
        self.is_heard_by(*peers)
        for _ in range(rospy.get_param("~rounds")):
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
    rospy.init_node("readvertised_test")
    is_long = rospy.has_param("~rounds")
    rostest.rosrun("dyknow", "readvertised", OftenTest if is_long else ReadvertisedTest)
