#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""However the process of a nodelet manager ends, its nodelets come back; unloads are followed.

The parameter ~repetitions says how often each way is tried, each time with a new manager.
"""

from __future__ import annotations

import signal
import unittest
from typing import Callable

import rosnode
import rospy
import rostest
from manager_suite import CHILD, ManagerCase, eventually, specification
from nodelet.srv import NodeletLoad, NodeletUnload
from processes import NODELET, STOCK_NODELET, Running
from std_msgs.msg import String

from dyknow.model.graph import State
from dyknow.ros.process.os_process import ProcessId

PEER = "/peer"
CPP = "/dyknow_cpp_nodelet_manager"
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

    def spawn(self, manager: str) -> None:
        for name, wiring in WIRING.items():
            label = name.strip("/12")
            protected = name in ("/counter", "/relay2")
            self.manager.client.spawn(label, name, wiring, protected, manager=manager)
            self.addCleanup(self.forget, name)

    def forget(self, name: str) -> None:
        for key in rospy.get_param_names():
            if key.startswith(name + "/"):
                rospy.delete_param(key)

    def order(self, way: str) -> None:
        publisher = rospy.Publisher("/fatal/order", String, queue_size=1, latch=True)
        try:
            child = self.manager.child()
            publisher.publish(way)
            eventually(publisher.get_num_connections, 10.0, "it listens")
            eventually(lambda: not child.alive, 20.0, "its process has ended")
        finally:
            publisher.unregister()

    def looks_as_spawned(self) -> bool:
        """Whether everything is as it was, with nothing added."""
        found = {each.name: each for each in self.manager.client.get_model().nodelets}
        return {
            name: {port.name: port.topic for port in nodelet.ports}
            for name, nodelet in found.items()
            if nodelet.state is State.RUNNING
            and nodelet.is_protected == (name in ("/counter", "/relay2"))
        } == WIRING

    def check_back(self, process: Callable[[], ProcessId], end: Callable[[], None]) -> None:
        self.assertTrue(self.looks_as_spawned())
        ended = process()
        end()
        eventually(lambda: not ended.alive, 10.0, "its process has ended")
        eventually(lambda: process() != ended, 10.0, "another has taken its place")
        eventually(self.looks_as_spawned, 10.0, "all nodelets are back")

    # A nodelet manager of the DyKnow manager's own

    def check_child(self, end: Callable[[], None]) -> None:
        self.spawn("")
        self.check_back(self.manager.child, end)

    def test_sigint(self):
        self.check_child(lambda: self.manager.child().signal(signal.SIGINT))

    def test_sigterm(self):
        self.check_child(lambda: self.manager.child().signal(signal.SIGTERM))

    def test_sigkill(self):
        self.check_child(lambda: self.manager.child().signal(signal.SIGKILL))

    def test_a_crash(self):
        self.check_child(lambda: self.manager.child().signal(signal.SIGSEGV))

    def test_rosnode_kill(self):
        self.check_child(lambda: rosnode.kill_nodes([CHILD]))

    def test_a_nodelet_that_shuts_the_node_down(self):
        self.check_child(lambda: self.order("shutdown"))

    def test_an_isolated_one(self):
        self.manager.client.spawn("relay", "/alone", {"in": "/s0", "out": "/s1"}, isolated=True)
        self.addCleanup(self.forget, "/alone")
        before = self.manager.nodelet("/alone")
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            ended = self.manager.child("/alone_nodelet_manager")
            ended.signal(number)
            eventually(lambda: not ended.alive, 10.0, "its process has ended")  # noqa: B023
            eventually(lambda: self.manager.nodelet("/alone") != before, 5.0, "it is missed")
            eventually(lambda: self.manager.nodelet("/alone") == before, 10.0, "it is back")

    def test_another_nodelet_manager_that_takes_the_name(self):
        """It keeps the name, as everywhere in ROS; once it has ended, everything is back."""
        self.spawn("")
        ended = self.manager.child()
        with Running(*NODELET, "manager", f"__name:={CHILD[1:]}"):
            eventually(lambda: not ended.alive, 10.0, "its process has ended")
            eventually(lambda: not self.looks_as_spawned(), 10.0, "the model shows it")
        eventually(self.looks_as_spawned, 40.0, "all nodelets are back")
        self.assertNotEqual(self.manager.child(), ended)

    def test_a_stock_nodelet_manager(self):
        self.manager.client.add_transformation(NATIVE)
        for number in range(3):
            self.manager.client.spawn("native", f"/native{number}", {"image": "/i"}, number == 0)
            self.addCleanup(self.forget, f"/native{number}")
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            ended = self.manager.child(CPP)
            ended.signal(number)
            eventually(lambda: self.manager.child(CPP) != ended, 10.0, "started")  # noqa: B023
            eventually(self.natives_run, 10.0, "all nodelets are back")

    def natives_run(self) -> bool:
        found = self.manager.client.get_model().nodelets
        return [each.name for each in found if each.state is State.RUNNING] == [
            f"/native{number}" for number in range(3)
        ]

    # An external nodelet manager, which is started, ended and started again

    def test_a_peer_that_others_end(self):
        peer = self.start_peer()
        self.spawn(PEER)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            peer.stop(number)
            peer.exit_code(20.0)
            eventually(self.all_lost, 5.0, "all nodelets are missed")
            peer = self.start_peer()
            eventually(self.looks_as_spawned, 10.0, "all nodelets are back")

    def test_another_nodelet_manager_that_takes_the_name_of_a_peer(self):
        peer = self.start_peer()
        self.spawn(PEER)
        self.start_peer()
        peer.exit_code(20.0)
        eventually(self.looks_as_spawned, 10.0, "all nodelets are back")

    def start_peer(self) -> Running:
        peer = Running(*NODELET, "manager", f"__name:={PEER[1:]}")
        self.addCleanup(peer.__exit__)
        peer.wait_for("Initializing nodelet")
        return peer

    def all_lost(self) -> bool:
        found = self.manager.client.get_model().nodelets
        return [each.name for each in found if each.state is State.LOST] == sorted(WIRING)

    # Nodelets that were unloaded on purpose

    def test_what_is_unloaded_by_the_stock_service_is_gone(self):
        self.spawn("")
        unload = rospy.ServiceProxy(f"{CHILD}/unload_nodelet", NodeletUnload)
        unload("/relay1")
        eventually(lambda: self.manager.nodelet("/relay1") is None, 1.0, "it is gone")
        self.manager.kill_child()
        self.assert_gone("/relay1")

    def test_a_nodelet_that_unloads_itself_is_gone(self):
        self.spawn("")
        self.manager.client.spawn("suicidal", "/suicidal", {"in": "/s0"})
        eventually(lambda: self.manager.nodelet("/suicidal") is None, 1.0, "it is gone")
        self.manager.kill_child()
        self.assert_gone("/suicidal")

    def test_what_a_broken_bond_unloads_is_gone(self):
        self.spawn("")
        with Running(*STOCK_NODELET, "load", "dyknow_manager_test/Relay", CHILD) as client:
            eventually(lambda: len(self.manager.client.get_model().nodelets) == 5, 5.0, "seen")
        self.assertTrue(client.has_ended)
        eventually(lambda: len(self.manager.client.get_model().nodelets) == 4, 10.0, "it is gone")
        self.assertTrue(self.looks_as_spawned())

    def assert_gone(self, name: str) -> None:
        others = [each for each in WIRING if each != name]
        load = rospy.ServiceProxy(f"{CHILD}/load_nodelet", NodeletLoad)
        load.wait_for_service(20.0)

        def all_back() -> bool:
            found = {each.name: each.state for each in self.manager.client.get_model().nodelets}
            return found == dict.fromkeys(others, State.RUNNING)

        eventually(all_back, 10.0, "the others are back, and nothing else")


def load_tests(loader, tests, pattern) -> unittest.TestSuite:
    names = loader.getTestCaseNames(EndsTest)
    repetitions = rospy.get_param("~repetitions", 1)
    return unittest.TestSuite(EndsTest(name) for name in names for _ in range(repetitions))


if __name__ == "__main__":
    rospy.init_node("ends_test")
    rostest.rosrun("dyknow", "ends_of_nodelet_managers", "__main__")
