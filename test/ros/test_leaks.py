#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Re-wiring and loading over and over: the process's resources do not grow."""

from __future__ import annotations

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

        try:
            eventually(back, 10.0, what)
        except AssertionError:
            self.fail(f"{what}: {self.last} descriptors and threads, {before} before")

    def test_rewirings_inside(self):
        self.manager.load("Talker", "/talker", {"/out": "/a"})
        self.manager.load("Relay", "/n", {"/in": "/a", "/out": "/b"})
        change = rospy.ServiceProxy("/n/set_config", SetConfig, persistent=True)

        def rewire(times):
            for number in range(times):
                pairs = (("/a", "/b"), ("/c", "/d"))[number % 2]
                config = [PortConfig("in", pairs[0]), PortConfig("out", pairs[1])]
                self.assertTrue(change(config).success)

        rewire(20)
        before, registered = self.holdings(), graph.registrations("/manager")
        rewire(INSIDE)
        eventually(lambda: graph.registrations("/manager") == registered, 5.0, "registrations")
        self.assert_back(before, f"after {INSIDE} re-wirings")
        change.close()

    def test_rewirings_across_processes(self):
        peers = [Ended(*PEER, "talk", "200", "/a", "/c"), Ended(*PEER, "listen", "/b", "/d")]
        for peer in peers:
            self.addCleanup(peer.__exit__)
        self.manager.load("Relay", "/n", {"/in": "/a", "/out": "/b"})
        peers[1].wait_for("/b ")
        change = rospy.ServiceProxy("/n/set_config", SetConfig, persistent=True)

        def rewire(times):
            for number in range(times):
                pairs = (("/c", "/d"), ("/a", "/b"))[number % 2]
                config = [PortConfig("in", pairs[0]), PortConfig("out", pairs[1])]
                self.assertTrue(change(config).success)

        rewire(10)
        before, registered = self.holdings(), graph.registrations("/manager")
        rewire(ACROSS)
        eventually(lambda: graph.registrations("/manager") == registered, 5.0, "registrations")
        self.assert_back(before, f"after {ACROSS} re-wirings")
        change.close()

    def test_loads_and_unloads(self):
        listener = rospy.Subscriber("/b", Header, lambda message: None)
        speaker = rospy.Publisher("/a", Header, queue_size=1)
        self.addCleanup(listener.unregister)
        self.addCleanup(speaker.unregister)

        def load_and_unload(times):
            for _ in range(times):
                self.manager.load("Relay", "/n", {"/in": "/a", "/out": "/b"})
                self.manager.load("Strand", "/strand", concurrent=True)
                call("/strand", "start_timer", 0.01)
                self.manager.unload_all()
                with self.assertRaises(rospy.ServiceException):
                    self.manager.load("FailsInInit", "/n", {"/in": "/a", "/out": "/b"})

        load_and_unload(5)
        before, registered = self.holdings(), graph.registrations("/manager")
        load_and_unload(LOADS)
        eventually(lambda: graph.registrations("/manager") == registered, 5.0, "registrations")
        self.assert_back(before, f"after {LOADS} loads and unloads")


if __name__ == "__main__":
    rospy.init_node("leaks_test")
    rostest.rosrun("dyknow", "leaks", "__main__")
