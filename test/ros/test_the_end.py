#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The end of a manager's process: orderly and in time, during any work of its nodelets."""

from __future__ import annotations

import signal
import time

import graph  # first: it makes the test package known
import rospy
from graph import Manager, call, peer
from processes import HELD_UP, NODELET, TellingCase, eventually, finished, run
from std_msgs.msg import Header


class EndTest(TellingCase):
    def setUp(self):
        self.manager = self.enter(Manager("/manager"))

    def assert_ends(self, *shut_down):
        """It ends in order, and has shut down each of the nodelets once."""
        begin = time.monotonic()
        self.assertEqual(self.manager.exit_code(20.0), 0, self.manager.output)
        self.assertLess(time.monotonic() - begin, HELD_UP)
        self.assertEqual(graph.registered("/manager"), set())
        output = self.manager.output
        self.assertNotIn("Traceback", output)
        self.assertNotIn("for the 2. time", output)
        for name in shut_down:
            self.assertEqual(output.count(f"{name}: shut down for the 1. time"), 1, output)

    def test_signals_and_rosnode_kill(self):
        """An impatient user does no harm."""
        names = ("/one", "/two", "/three")
        for end in (
            lambda: self.manager.stop(signal.SIGINT),
            lambda: self.manager.stop(signal.SIGTERM),
            lambda: [self.manager.stop() for _ in range(5)],
            lambda: self.assertEqual(finished(["rosnode", "kill", "/manager"])[0], 0),
        ):
            if self.manager.has_ended:
                self.setUp()
            for name in names:
                self.manager.load("Fragile", name, {"/in": "/a", "/out": "/b"})
            end()
            self.assert_ends(*names)

    def test_in_the_middle_of_callbacks_that_do_not_return(self):
        speaker = self.publisher("/orders", Header)
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
        self.assert_ends("/fragile")
        for number in range(8):
            self.assertIn(f"/n{number}: shutting down for ever", self.manager.output)
            self.assertIn(f"/n{number}: on_shutdown has not returned", self.manager.output)

    def test_in_the_middle_of_on_init(self):
        rospy.set_param("/go_on", False)
        words = ("load", "dyknow_test/WaitsInInit", "manager", "--no-bond", "__name:=slow")
        client = self.run_process(*NODELET, *words)
        eventually(lambda: "/slow/get_config" in graph.services_of("/manager"), 10.0, "it waits")
        self.manager.stop()
        self.assert_ends()
        self.assertEqual(client.exit_code(20.0), 255)

    def test_in_the_middle_of_set_config(self):
        talker = self.run_process(*peer("talk", "100", "/a"))
        eventually(lambda: graph.nodes_on("/a")[0], 10.0, "it is registered")
        talker.stop(signal.SIGSTOP)
        self.manager.load("Relay", "/n")
        self.run_process("rosservice", "call", "/n/set_config", "[{port: in, topic: /a}]")
        eventually(lambda: "/manager" in graph.nodes_on("/a")[1], 10.0, "it is being made")
        self.manager.stop()
        self.assert_ends()

    def test_under_load(self):
        self.run_process(*peer("talk", "500", "/a"))
        listener = self.run_process(*peer("listen", "/b"))
        self.manager.load("Relay", "/n", {"/in": "/a", "/out": "/b"})
        listener.wait_for("/b ")
        self.manager.stop()
        self.assert_ends()


if __name__ == "__main__":
    run()
