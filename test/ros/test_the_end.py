#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The end of a manager's process: orderly and in time, during any work of its nodelets."""

from __future__ import annotations

import signal
import time

import graph  # first: it makes the test package known
import rospy
import rostest
from graph import PEER, Ended, Manager, call
from processes import TellingCase, eventually, finished
from std_msgs.msg import Header

NOTHING = {"publishers": [], "subscribers": [], "services": []}


class EndTest(TellingCase):
    def setUp(self):
        self.manager = Manager("/manager")
        self.addCleanup(self.manager.__exit__)

    def assert_ends(self, within=3.0):
        begin = time.monotonic()
        self.assertEqual(self.manager.exit_code(20.0), 0, self.manager.output)
        self.assertLess(time.monotonic() - begin, within)
        self.assertEqual(graph.registrations("/manager"), NOTHING)
        self.assertNotIn("Traceback", self.manager.output)

    def test_signals_shut_each_nodelet_down_once(self):
        for number in (signal.SIGINT, signal.SIGTERM):
            with self.subTest(number):
                if self.manager.has_ended:
                    self.manager = Manager("/manager")
                    self.addCleanup(self.manager.__exit__)
                for name in ("/one", "/two", "/three"):
                    self.manager.load("Fragile", name, {"/in": "/a", "/out": "/b"})
                self.manager.stop(number)
                self.assert_ends()
                for name in ("/one", "/two", "/three"):
                    self.assertEqual(
                        self.manager.output.count(f"{name}: shut down for the 1. time"), 1
                    )
                self.assertNotIn("for the 2. time", self.manager.output)

    def test_rosnode_kill(self):
        self.manager.load("Fragile", "/one", {"/in": "/a"})
        code, output = finished(["rosnode", "kill", "/manager"])
        self.assertEqual(code, 0, output)
        self.assert_ends()
        self.assertEqual(self.manager.output.count("/one: shut down for the 1. time"), 1)

    def test_an_impatient_user(self):
        for name in ("/one", "/two"):
            self.manager.load("Fragile", name, {"/in": "/a"})
        for _ in range(5):
            self.manager.stop()
        self.assert_ends()
        self.assertEqual(self.manager.output.count("shut down for the 1. time"), 2)
        self.assertNotIn("for the 2. time", self.manager.output)

    def test_in_the_middle_of_callbacks_that_do_not_return(self):
        speaker = rospy.Publisher("/orders", Header, queue_size=1)
        self.addCleanup(speaker.unregister)
        names = [f"/n{number}" for number in range(6)]
        for name in names:
            self.manager.load("Fragile", name, {"/in": "/orders"})
        eventually(speaker.get_num_connections, 5.0, "connected")
        speaker.publish(Header(frame_id="hang"))
        for name in names:
            eventually(lambda name=name: call(name, "received"), 5.0, f"{name} hangs")
        self.manager.stop()
        self.assert_ends()

    def test_nodelets_that_hang_at_the_end(self):
        for number in range(8):
            self.manager.load("HangsAtTheEnd", f"/n{number}")
        self.manager.load("Fragile", "/fragile")
        self.manager.stop()
        self.assert_ends()
        self.assertEqual(self.manager.output.count("/fragile: shut down for the 1. time"), 1)
        for number in range(8):
            self.assertIn(f"/n{number}: shutting down for ever", self.manager.output)
            self.assertIn(f"/n{number}: on_shutdown has not returned", self.manager.output)

    def test_in_the_middle_of_on_init(self):
        rospy.set_param("/go_on", False)
        client = Ended(
            *graph.NODELET,
            "load",
            "dyknow_test/WaitsInInit",
            "manager",
            "--no-bond",
            "__name:=slow",
        )
        self.addCleanup(client.__exit__)
        eventually(lambda: "/slow/get_config" in graph.services_of("/manager"), 10.0, "it waits")
        self.manager.stop()
        self.assert_ends()
        self.assertEqual(client.exit_code(20.0), 255)

    def test_in_the_middle_of_set_config(self):
        peer = Ended(*PEER, "talk", "100", "/a")
        self.addCleanup(peer.__exit__)
        eventually(lambda: graph.nodes_on("/a")[0], 10.0, "it is registered")
        peer.stop(signal.SIGSTOP)
        self.manager.load("Relay", "/n")
        client = Ended("rosservice", "call", "/n/set_config", "[{port: in, topic: /a}]")
        self.addCleanup(client.__exit__)
        eventually(lambda: "/manager" in graph.nodes_on("/a")[1], 10.0, "it is being made")
        self.manager.stop()
        self.assert_ends()

    def test_under_load(self):
        peer = Ended(*PEER, "talk", "500", "/a")
        listener = Ended(*PEER, "listen", "/b")
        for process in (peer, listener):
            self.addCleanup(process.__exit__)
        self.manager.load("Relay", "/n", {"/in": "/a", "/out": "/b"})
        listener.wait_for("/b ")
        self.manager.stop()
        self.assert_ends()


if __name__ == "__main__":
    rospy.init_node("end_test")
    rostest.rosrun("dyknow", "the_end", "__main__")
