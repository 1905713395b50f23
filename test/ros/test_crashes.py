#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that crash their process repeatedly: their neighbours are left in peace."""

from __future__ import annotations

import os
import signal

import rosgraph
import rospkg
import rospy
import rostest
from graph import Heard
from manager_suite import (
    CHILD,
    ManagerCase,
    counted,
    everything,
    gaps,
)
from nodelet.srv import NodeletUnload
from processes import becomes, eventually

from dyknow.model.graph import State

NEIGHBOURS = ("/counter", "/relay")


class CrashesTest(ManagerCase):
    def setUp(self):
        self.manager = self.started()
        self.client = self.manager.client
        self.client.spawn("counter", "/counter", {"out": "/s0"}, True)
        self.client.spawn("relay", "/relay", {"in": "/s0", "out": "/s1"})
        self.heard = self.enter(Heard("/s1", note=counted))
        self.heard.flows()

    def spawn_fatal(self, topic: str = "", **moments: str) -> None:
        """Spawn a nodelet that ends its process at the given moments, but not in the spawn."""
        self.client.spawn("fatal", "/fatal", {"in": topic})
        for moment, way in moments.items():
            rospy.set_param(f"/fatal/{moment}", way)
            self.addCleanup(forget, f"/fatal/{moment}")

    def is_alone(self) -> None:
        eventually(lambda: self.manager.nodelet("/fatal").isolated, 10.0, "it is alone")
        self.assert_left_in_peace()

    def assert_left_in_peace(self) -> None:
        """The neighbours' process lives on, without losing a message."""
        for name in NEIGHBOURS:
            self.manager.becomes(name, State.RUNNING)
        self.heard.flows()
        del self.heard[:]
        child = self.manager.child()
        self.heard.flows(100)
        self.assertEqual(self.manager.child(), child)
        self.assertEqual(gaps(self.heard), [])

    def test_one_that_crashes_on_each_message_is_kept_apart(self):
        for way in ("segfault", "exit"):
            with self.subTest(way):
                self.spawn_fatal("/s0", on_message=way)
                self.is_alone()
                found = self.manager.nodelet("/fatal").detail
                self.assertRegex(found, "alone .* SIGSEGV|alone .* exit code 3")
                self.assertRegex(self.manager.output, "crashed .* while it ran code of .*/fatal")
                self.client.destroy("/fatal")
                self.manager.is_gone("/fatal")

    def test_one_whose_on_init_crashes_is_kept_apart(self):
        self.spawn_fatal(on_init="abort")
        self.manager.child().signal(signal.SIGKILL)
        self.is_alone()
        found = self.manager.becomes("/fatal", State.FAILED)
        self.assertIn("SIGABRT", found.detail)
        forget("/fatal/on_init")
        self.manager.becomes("/fatal", State.RUNNING)

    def test_one_that_crashes_when_it_is_destroyed_or_unloaded_is_gone(self):
        def unload() -> None:
            with self.assertRaises(rospy.ServiceException):
                rospy.ServiceProxy(f"{CHILD}/unload_nodelet", NodeletUnload)("/fatal")

        for end in (unload, lambda: self.client.destroy("/fatal")):
            self.spawn_fatal(on_shutdown="segfault")
            end()
            self.manager.is_gone("/fatal")
            self.assert_left_in_peace()
            self.assertIsNone(self.manager.nodelet("/fatal"))


def forget(parameter: str) -> None:
    if rospy.has_param(parameter):
        rospy.delete_param(parameter)


def files() -> list[str]:
    """Files of this master's nodelet managers in the log folder."""
    host, port = rosgraph.network.parse_http_host_and_port(rosgraph.get_master_uri())
    return os.listdir(os.path.join(rospkg.get_log_dir(), f"dyknow-{host}-{port}"))


class LeftoversTest(ManagerCase):
    def test_what_dies_leaves_nothing(self):
        manager, name = self.started(), "/alone_nodelet_manager"
        before = everything()

        manager.client.spawn("relay", "/alone", {"in": "/a"}, isolated=True)
        for child in (name, CHILD):
            manager.kill_child(child)
        manager.becomes("/alone", State.RUNNING)
        self.assertIn("alone_nodelet_manager-running", files())
        manager.client.destroy("/alone")
        becomes(lambda: everything() ^ before, set())
        self.assertNotIn("alone_nodelet_manager-running", files())


if __name__ == "__main__":
    rospy.init_node("crashes_test")
    rostest.rosrun("dyknow", "crashes", "__main__")
