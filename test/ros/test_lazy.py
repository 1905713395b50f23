#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Lazy nodelets: they work only while they have subscribers, in their process or in another."""

from __future__ import annotations

import unittest

import rospy
import rostest
from graph import PEER, Manager, call
from processes import Running, eventually
from std_msgs.msg import Header


class LazyTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.manager = Manager("/manager")
        cls.other = Manager("/other")

    @classmethod
    def tearDownClass(cls):
        cls.manager.__exit__()
        cls.other.__exit__()

    def tearDown(self):
        self.manager.unload_all()
        self.other.unload_all()

    def load_chain(self, length, managers, **parameters):
        for number in range(length):
            topics = {"/in": f"/t{number}", "/out": f"/t{number + 1}"}
            manager = managers[number % len(managers)]
            manager.load("Lazy", f"/lazy{number}", topics, **parameters)
        return [f"/lazy{number}" for number in range(length)]

    def settle(self, chain, listening):
        eventually(
            lambda: [call(name, "is_listening") for name in chain] == [listening] * len(chain),
            10.0,
            f"listening: {listening}",
        )
        for name in chain:
            self.assertEqual(call(name, "connections"), int(listening))

    def check_delivery(self, listener, chain):
        """A message published at the head of the chain arrives at its end."""
        call("/talker", "publish", 1, 1)
        eventually(lambda: 1 in call(listener, "received"), 5.0, "through the whole chain")

    def test_a_chain_over_two_processes(self):
        self.manager.load("Talker", "/talker", {"/out": "/t0"})
        chain = self.load_chain(4, [self.manager, self.other])
        self.settle(chain, False)
        self.manager.load("Listener", "/end", {"/in": "/t4"})
        self.settle(chain, True)
        self.check_delivery("/end", chain)
        self.manager.unload("/end")
        self.settle(chain, False)

    def test_inside_and_outside_mixed(self):
        self.manager.load("Lazy", "/lazy", {"/in": "/a", "/out": "/b"})
        self.manager.load("Listener", "/one", {"/in": "/b"})
        self.manager.load("Listener", "/two", {"/in": "/b"})
        self.other.load("Listener", "/three", {"/in": "/b"})
        told = [["subscribe", "/b", 1], ["subscribe", "/b", 2]]
        eventually(lambda: call("/lazy", "story") == told, 5.0, "one for each process")
        peer = Running(*PEER, "listen", "/b")
        self.addCleanup(peer.__exit__)
        eventually(lambda: call("/lazy", "connections") == 3, 10.0, "a third process")
        self.manager.unload("/one")
        self.other.unload("/three")
        told += [["subscribe", "/b", 3], ["unsubscribe", "/b", 2]]
        eventually(lambda: call("/lazy", "story") == told, 5.0, "a process has left")
        self.manager.unload("/two")
        told += [["unsubscribe", "/b", 1]]
        eventually(lambda: call("/lazy", "story") == told, 5.0, "the last of this process")
        self.assertTrue(call("/lazy", "is_listening"))
        peer.__exit__()
        told += [["unsubscribe", "/b", 0]]
        eventually(lambda: call("/lazy", "story") == told, 5.0, "all have left")
        eventually(lambda: not call("/lazy", "is_listening"), 5.0, "it listens no more")

    def test_ordinary_subscribers_of_the_process_are_no_peer_of_their_own(self):
        self.manager.load("Lazy", "/lazy", {"/in": "/a", "/out": "/b"})
        self.manager.load("Ordinary", "/n")
        call("/n", "make_subscriber", "rospy", "rospy", "/b")
        told = [["subscribe", "/b", 1]]
        eventually(lambda: call("/lazy", "story") == told, 5.0, "an ordinary one")
        call("/n", "make_subscriber", "bus", "bus", "/b")
        self.assertEqual(call("/lazy", "connections"), 1)
        call("/n", "remove", "rospy")
        self.assertEqual(call("/lazy", "connections"), 1)
        call("/n", "remove", "bus")
        told += [["unsubscribe", "/b", 0]]
        eventually(lambda: call("/lazy", "story") == told, 5.0, "both have left")

    def test_each_newcomer_alone_is_welcomed(self):
        heard = []
        for latch in (False, True):
            self.manager.load("Lazy", "/lazy", {"/in": "/a", "/out": "/b"}, latch=latch)
            self.manager.load("Listener", "/inside", {"/in": "/b"})
            eventually(lambda: call("/inside", "senders") == {"welcome": 1}, 5.0, "inside")
            del heard[:]
            subscriber = rospy.Subscriber("/b", Header, heard.append)
            eventually(lambda: [m.frame_id for m in heard] == ["welcome"], 5.0, "outside")
            eventually(lambda: call("/lazy", "connections") == 2, 5.0, "connected")
            self.assertEqual(call("/inside", "senders"), {"welcome": 1})
            subscriber.unregister()
            self.manager.unload_all()


if __name__ == "__main__":
    rospy.init_node("lazy_test")
    rostest.rosrun("dyknow", "lazy", "__main__")
