#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""However the process of a nodelet manager ends, its nodelets come back; unloads are followed.

Nodelets that crash it are kept apart. The parameter ~repetitions says how often each end is tried.
"""

from __future__ import annotations

import os
import signal
import time
import unittest
from typing import Any

import rosgraph
import rosnode
import rospkg
import rospy
from graph import Heard
from manager_suite import (
    CHILD,
    CPP_CHILD,
    ManagerCase,
    counted,
    everything,
    gaps,
    listed,
    specification,
)
from nodelet.srv import NodeletUnload
from processes import NODELET, STOCK_NODELET, Running, becomes, eventually, forget, run
from std_msgs.msg import String

from dyknow.model.graph import State

PEER = "/peer"
#: Seconds: what has served for one is started again at once, and anything else after a pause that
#: grows each time.
SERVED = 1.1
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
PROTECTED = ("/counter", "/relay2")
NEIGHBOURS = ("/counter", "/relay")
NATIVE = specification("native", "image_proc/resize", ">image ~image>")
#: Port to topic, by nodelet; an order makes `/fatal` end its process.
WIRING = {
    "/counter": {"out": "/s0"},
    "/relay1": {"in": "/s0", "out": "/s1"},
    "/relay2": {"in": "/s1", "out": "/s2"},
    "/fatal": {"in": "", "out": ""},
}


class EndsTest(ManagerCase):
    def setUp(self):
        peers = [PEER] if "peer" in self._testMethodName else []
        self.manager = self.started(nodelet_managers=peers)
        self.client = self.manager.client

    def spawn(self, manager: str = "") -> None:
        for name, wiring in WIRING.items():
            label = name.strip("/12")
            self.client.spawn(label, name, wiring, name in PROTECTED, manager=manager)

    def nodelets(self) -> Any:
        return self.client.get_model().nodelets

    def are(self, state: State, *names: str) -> None:
        """Wait until exactly these nodelets are in a state."""
        becomes(lambda: {n.name for n in self.nodelets() if n.state is state}, {*names})

    def looks_as_spawned(self) -> bool:
        """Whether everything is as it was, with nothing added."""
        return {
            each.name: {port.name: port.topic for port in each.ports}
            for each in self.nodelets()
            if each.state is State.RUNNING and each.is_protected == (each.name in PROTECTED)
        } == WIRING

    def is_back(self) -> None:
        eventually(self.looks_as_spawned, 10.0, "all nodelets are back", self.nodelets)
        time.sleep(SERVED)

    # A nodelet manager of the DyKnow manager's own

    def order_shutdown(self) -> None:
        order = rospy.Publisher("/fatal/order", String, queue_size=1, latch=True)
        child = self.manager.child()
        order.publish("shutdown")
        eventually(lambda: not child.alive, 20.0, "its process has ended")
        order.unregister()

    def test_a_child(self):
        self.spawn()
        ends = [
            lambda number=number: self.manager.child().signal(number)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL, signal.SIGSEGV)
        ]
        for end in (*ends, lambda: rosnode.kill_nodes([CHILD]), self.order_shutdown):
            ended = self.manager.child()
            end()
            eventually(lambda: self.manager.child() != ended, 10.0, "started")  # noqa: B023
            self.is_back()

    def test_an_isolated_one(self):
        self.client.spawn("relay", "/alone", {"in": "/s0", "out": "/s1"}, isolated=True)
        before = self.manager.nodelet("/alone")
        for number in SIGNALS:
            self.manager.kill_child("/alone_nodelet_manager", number)
            becomes(lambda: self.manager.nodelet("/alone"), before)

    def test_another_nodelet_manager_that_takes_the_name(self):
        """It keeps the name, as everywhere in ROS; once it has ended, everything is back."""
        self.spawn()
        ended = self.manager.child()
        with Running(*NODELET, "manager", f"__name:={CHILD[1:]}"):
            eventually(lambda: not ended.alive, 10.0, "its process has ended")
            eventually(lambda: not self.looks_as_spawned(), 10.0, "the model shows it")
        self.is_back()
        self.assertNotEqual(self.manager.child(), ended)

    def test_a_stock_nodelet_manager(self):
        self.client.add_transformation(NATIVE)
        names = [f"/native{number}" for number in range(3)]
        for name in names:
            self.client.spawn("native", name, {"image": "/i"}, name == names[0])
        for number in SIGNALS:
            self.manager.kill_child(CPP_CHILD, number)
            self.are(State.RUNNING, *names)
            time.sleep(SERVED)

    # An external nodelet manager, which is started, ended and started again

    def start_peer(self) -> Running:
        peer = self.run_process(*NODELET, "manager", f"__name:={PEER[1:]}")
        peer.wait_for("Initializing nodelet")
        return peer

    def test_a_peer_that_others_end_and_one_that_takes_its_name(self):
        peer = self.start_peer()
        eventually(lambda: listed(PEER) is not None, 10.0, "it is up")
        self.spawned(self.manager, "/first", PEER)
        self.client.destroy("/first")
        self.spawn(PEER)
        for number in SIGNALS:
            peer.stop(number)
            peer.exit_code(20.0)
            self.are(State.LOST, *WIRING)
            peer = self.start_peer()
            self.is_back()
        self.start_peer()
        peer.exit_code(20.0)
        self.is_back()

    # Nodelets that were unloaded on purpose

    def test_what_was_unloaded_stays_away(self):
        """By the stock service, by itself, or by a broken bond."""
        self.spawn()
        rospy.ServiceProxy(f"{CHILD}/unload_nodelet", NodeletUnload)("/relay1")
        self.manager.is_gone("/relay1")
        self.client.spawn("suicidal", "/suicidal", {"in": "/s0"})
        self.manager.is_gone("/suicidal")
        with Running(*STOCK_NODELET, "load", "dyknow_manager_test/Relay", CHILD) as client:
            eventually(lambda: len(self.nodelets()) == 4, 5.0, "it is seen")
        self.assertTrue(client.has_ended)
        left = {*WIRING} - {"/relay1"}
        becomes(lambda: {each.name for each in self.nodelets()}, left)
        self.manager.kill_child()
        self.are(State.RUNNING, *left)
        self.assertEqual({each.name for each in self.nodelets()}, left)


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
            self.parameter(f"/fatal/{moment}", way)

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

    def test_what_dies_leaves_nothing(self):
        before, name = everything(), "/alone_nodelet_manager"
        self.client.spawn("relay", "/alone", {"in": "/a"}, isolated=True)
        for child in (name, CHILD):
            self.manager.kill_child(child)
        self.manager.becomes("/alone", State.RUNNING)
        self.assertIn("alone_nodelet_manager-running", files())
        self.client.destroy("/alone")
        becomes(lambda: everything() ^ before, set())
        self.assertNotIn("alone_nodelet_manager-running", files())


def files() -> list[str]:
    """Files of this master's nodelet managers in the log folder."""
    host, port = rosgraph.network.parse_http_host_and_port(rosgraph.get_master_uri())
    return os.listdir(os.path.join(rospkg.get_log_dir(), f"dyknow-{host}-{port}"))


def load_tests(loader, tests, pattern) -> unittest.TestSuite:
    names = loader.getTestCaseNames(EndsTest)
    repetitions = rospy.get_param("~repetitions", 1)
    repeated = [EndsTest(name) for name in names for _ in range(repetitions)]
    return unittest.TestSuite([*repeated, loader.loadTestsFromTestCase(CrashesTest)])


if __name__ == "__main__":
    run()
