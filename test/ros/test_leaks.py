#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Re-wiring and loading over and over: the process's resources do not grow."""

from __future__ import annotations

import itertools
import unittest

import graph  # first: it makes the test package known
import rospy
import rostest
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import SetConfig
from graph import PEER, Ended, Manager, call
from processes import eventually
from std_msgs.msg import Header

#: For connections that the master keeps, and workers that were started while the machine was busy.
SPARE = 10
#: Rounds inside the process, across processes, and of loads.
INSIDE, ACROSS, LOADS = 1000, 100, 100


class LeakTest(unittest.TestCase):
    def setUp(self):
        self.manager = Manager("/manager")
        self.addCleanup(self.manager.__exit__)

    def holdings(self):
        return self.manager.descriptors(), self.manager.threads()

    def assert_back(self, before, what):
        """Wait until there are no more descriptors and threads than before.

        rospy's registrations and closing of connections take some time.
        """

        def back():
            self.last = self.holdings()
            return all(now <= then + SPARE for now, then in zip(self.last, before))

        eventually(
            back, 10.0, what, lambda: f"{self.last} descriptors and threads, {before} before"
        )

    def rewires(self, warm, rounds, *topics):
        """Move both ports of /n between pairs of topics, over one connection."""
        change = rospy.ServiceProxy("/n/set_config", SetConfig, persistent=True)
        self.addCleanup(change.close)
        pairs = itertools.cycle(topics)

        def rewire():
            source, target = next(pairs)
            self.assertTrue(change([PortConfig("in", source), PortConfig("out", target)]).success)

        self.leaves_nothing(rewire, warm, rounds)

    def leaves_nothing(self, action, warm, rounds):
        for _ in range(warm):
            action()
        before, registered = self.holdings(), graph.registrations("/manager")
        for _ in range(rounds):
            action()
        eventually(lambda: graph.registrations("/manager") == registered, 5.0, "registrations")
        self.assert_back(before, f"after {rounds} rounds")

    def test_rewirings_inside(self):
        self.manager.load("Talker", "/talker", {"/out": "/a"})
        self.manager.load("Relay", "/n", {"/in": "/a", "/out": "/b"})
        self.rewires(20, INSIDE, ("/a", "/b"), ("/c", "/d"))

    def test_rewirings_across_processes(self):
        peers = [Ended(*PEER, "talk", "200", "/a", "/c"), Ended(*PEER, "listen", "/b", "/d")]
        for peer in peers:
            self.addCleanup(peer.__exit__)
        self.manager.load("Relay", "/n", {"/in": "/a", "/out": "/b"})
        peers[1].wait_for("/b ")
        self.rewires(10, ACROSS, ("/c", "/d"), ("/a", "/b"))

    def test_loads_and_unloads(self):
        listener = rospy.Subscriber("/b", Header, lambda message: None)
        speaker = rospy.Publisher("/a", Header, queue_size=1)
        self.addCleanup(listener.unregister)
        self.addCleanup(speaker.unregister)
        topics = {"/in": "/a", "/out": "/b"}

        def load_and_unload():
            self.manager.load("Relay", "/n", topics)
            self.manager.load("Metronome", "/metronome")
            call("/metronome", "start", 0.01)
            self.manager.unload_all()
            with self.assertRaises(rospy.ServiceException):
                self.manager.load("FailsInInit", "/n", topics)

        self.leaves_nothing(load_and_unload, 5, LOADS)


if __name__ == "__main__":
    rospy.init_node("leaks_test")
    rostest.rosrun("dyknow", "leaks", "__main__")
