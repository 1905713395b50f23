#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""However the process of a nodelet manager ends, its nodelets come back; unloads are followed.

The parameter ~repetitions says how often each way is tried, each time with a new manager.
"""

from __future__ import annotations

import signal
import unittest
from typing import Any

import rosnode
import rospy
import rostest
from manager_suite import CHILD, CPP_CHILD, ManagerCase, listed, specification
from nodelet.srv import NodeletUnload
from processes import NODELET, STOCK_NODELET, Running, becomes, eventually
from std_msgs.msg import String

from dyknow.model.graph import State

PEER = "/peer"
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
PROTECTED = ("/counter", "/relay2")
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
        """Wait until these nodelets, and no others, are in a state."""
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


def load_tests(loader, tests, pattern) -> unittest.TestSuite:
    names = loader.getTestCaseNames(EndsTest)
    repetitions = rospy.get_param("~repetitions", 1)
    return unittest.TestSuite(EndsTest(name) for name in names for _ in range(repetitions))


if __name__ == "__main__":
    rospy.init_node("ends_test")
    rostest.rosrun("dyknow", "ends_of_nodelet_managers", "__main__")
