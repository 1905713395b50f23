#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`nodelet load` and `unload` with nodelet_core's manager in C++, and with an odd one."""

from __future__ import annotations

import queue
import signal
import threading
import time
import unittest

import graph
import rospy
import rostest
from nodelet.srv import (
    NodeletList,
    NodeletLoad,
    NodeletLoadResponse,
    NodeletUnload,
    NodeletUnloadResponse,
)
from processes import BUSY, NODELET, STOCK_NODELET, Running, eventually, finished, nodes

MANAGER = "/command_test/manager"
BOND = f"{MANAGER}/bond"


def nodelets(manager=MANAGER):
    return list(rospy.ServiceProxy(f"{manager}/list", NodeletList)().nodelets)


class Started(unittest.TestCase):
    def start(self, *command):
        process = Running(*command)
        self.addCleanup(process.__exit__)
        return process


class WithManager:
    """Tests that apply to the manager in C++ and to DyKnow's."""

    def setUp(self):
        self.manager = self.start(
            *self.nodelet, "manager", "__name:=manager", "__ns:=/command_test"
        )
        rospy.wait_for_service(f"{MANAGER}/list", 10.0 * BUSY)

    def load(self, *arguments, name="nodelet"):
        process = self.start(
            *NODELET, "load", self.type, *arguments, f"__name:={name}", "__ns:=/command_test"
        )
        eventually(
            lambda: f"/command_test/{name}" in nodelets() or process.has_ended,
            15.0,
            "the nodelet is loaded",
        )
        self.assertIn(f"/command_test/{name}", nodelets(), process.output)
        return process

    def assert_ends(self, process, code=0, within=4.0):
        """It ends by itself, in the time (s) of a quiet machine."""
        self.assertEqual(process.exit_code(within * BUSY), code, process.output)

    def test_signals_unload(self):
        for number in (signal.SIGINT, signal.SIGTERM):
            for arguments in ((), ("--no-bond",)):
                process = self.load(MANAGER, *arguments)
                process.stop(number)
                self.assert_ends(process)
                self.assertEqual(nodelets(), [])
                self.assertIn(
                    f"Unloading nodelet /command_test/nodelet from manager {MANAGER}\n",
                    process.output,
                )
                self.assertNotIn("/command_test/nodelet", nodes())

    def test_rosnode_kill_unloads(self):
        process = self.load(MANAGER)
        code, output = finished(["rosnode", "kill", "/command_test/nodelet"])
        self.assertEqual(code, 0, output)
        self.assert_ends(process)
        self.assertEqual(nodelets(), [])
        self.assertNotIn("/command_test/nodelet", nodes())

    def test_the_manager_misses_a_killed_client(self):
        process = self.load(MANAGER)
        graph.let_the_bond_form(BOND)
        process.stop(signal.SIGKILL)
        eventually(lambda: nodelets() == [], 5.5, "the nodelet is unloaded")

    def test_a_killed_client_without_bond_leaves_the_nodelet(self):
        process = self.load(MANAGER, "--no-bond")
        process.stop(signal.SIGKILL)
        process.exit_code(20.0)
        code, output = finished([*NODELET, "unload", "/command_test/nodelet", MANAGER])
        self.assertEqual(code, 0, output)
        self.assertEqual(nodelets(), [])

    def test_the_client_ends_with_the_manager(self):
        for number in (signal.SIGKILL, signal.SIGINT):
            process = self.load(MANAGER)
            graph.let_the_bond_form(BOND)
            self.manager.stop(number)
            self.assert_ends(process, within=6.0)
            self.assertIn("Bond broken, exiting\n", process.output)
            self.manager.exit_code(20.0)
            self.setUp()

    def test_the_client_ends_when_others_unload(self):
        process = self.load(MANAGER)
        graph.let_the_bond_form(BOND)
        code, output = finished([*NODELET, "unload", "/command_test/nodelet", MANAGER])
        self.assertEqual(code, 0, output)
        self.assert_ends(process, within=2.0)
        self.assertIn("Bond broken, exiting\n", process.output)
        self.assertNotIn("Unloading", process.output)

    def test_a_stopped_manager_does_not_hold_up_the_client(self):
        process = self.load(MANAGER)
        graph.let_the_bond_form(BOND)
        self.manager.stop(signal.SIGSTOP)
        process.stop()
        self.assert_ends(process, within=3.5)
        self.assertIn("did not answer within 2 s", process.output)
        self.manager.stop(signal.SIGCONT)
        eventually(lambda: nodelets() == [], 5.0, "the nodelet is unloaded")

    def test_a_dead_manager_does_not_hold_up_the_client(self):
        process = self.load(MANAGER)
        graph.let_the_bond_form(BOND)  # so that the client has its answer
        self.manager.stop(signal.SIGKILL)
        self.manager.exit_code(20.0)
        process.stop()
        self.assert_ends(process)
        self.assertNotIn("Couldn't find", process.output)  # both may be ending together

    def test_what_the_manager_refuses(self):
        code, output = finished([*NODELET, "load", "image_proc/nothing", MANAGER])
        self.assertEqual(code, 255)
        self.assertIn(
            "Failed to load nodelet '/image_proc_nothing` of type `image_proc/nothing` "
            f"to manager `{MANAGER}'",
            output,
        )
        code, output = finished([*NODELET, "unload", "/nobody", MANAGER])
        self.assertEqual(code, 255)
        self.assertIn(f"Failed to unload nodelet '/nobody` from manager `{MANAGER}'", output)

    def test_a_name_that_is_taken_stays_with_the_first(self):
        self.load(MANAGER, "--no-bond").stop(signal.SIGKILL)
        code, output = finished(
            [*NODELET, "load", self.type, MANAGER, "__name:=nodelet", "__ns:=/command_test"]
        )
        self.assertEqual(code, 255, output)
        self.assertEqual(nodelets(), ["/command_test/nodelet"])


class StockManagerTest(WithManager, Started):
    nodelet = STOCK_NODELET
    type = "image_proc/resize"

    def test_remappings_parameters_and_names(self):
        process = self.load("manager", "image:=cam/image", "~image:=small", "_scale_width:=0.25")
        published = {topic for topic, _ in rospy.get_published_topics()}
        self.assertIn("/command_test/small", published)
        self.assertEqual(rospy.get_param("/command_test/nodelet/scale_width"), 0.25)
        self.assertIn(
            "Loading nodelet /command_test/nodelet of type image_proc/resize to manager manager "
            "with the following remappings:",
            process.output,
        )
        self.assertIn("/command_test/image -> /command_test/cam/image\n", process.output)
        self.assertIn("/command_test/nodelet/image -> /command_test/small\n", process.output)
        self.assertNotIn("__name", process.output)


class OurManagerTest(WithManager, Started):
    nodelet = NODELET
    type = "dyknow/Relay"

    def test_remappings_parameters_and_names(self):
        process = self.load("manager", "out:=cam/out", "_datatype:=std_msgs/Time")
        published = dict(rospy.get_published_topics())
        self.assertEqual(published.get("/command_test/cam/out"), "std_msgs/Time")
        self.assertIn("/command_test/out -> /command_test/cam/out\n", process.output)


class WaitingTest(Started):
    def test_unload_without_a_manager(self):
        code, output = finished([*NODELET, "unload", "/n", "/nobody"])
        self.assertEqual(code, 255)
        self.assertIn("Unloading nodelet /n from manager /nobody\n", output)
        self.assertIn("Couldn't find service /nobody/unload_nodelet, perhaps the manager", output)

    def test_load_waits_for_the_manager(self):
        process = self.start(*NODELET, "load", "image_proc/resize", "/late", "__name:=early")
        process.wait_for("waitForService: Service [/late/load_nodelet] has not been advertised")
        process.wait_for(
            "Waiting for service /late/load_nodelet to be available for 10 seconds..."
        )
        self.start(*STOCK_NODELET, "manager", "__name:=late")
        process.wait_for("waitForService: Service [/late/load_nodelet] is now available.")
        eventually(lambda: nodelets("/late") == ["/early"], 10.0, "the nodelet is loaded")

    def test_a_client_that_waits_can_be_stopped(self):
        for stop in (
            lambda process: process.stop(signal.SIGINT),
            lambda process: process.stop(signal.SIGTERM),
            lambda process: finished(["rosnode", "kill", "/waiting"]),
        ):
            process = self.start(*NODELET, "load", "a/B", "/nobody", "__name:=waiting")
            process.wait_for("has not been advertised, waiting...")
            stop(process)
            self.assertEqual(process.exit_code(20.0), 130, process.output)
            self.assertNotIn("Unloading", process.output)
            self.assertNotIn("Traceback", process.output)


class OddManagerTest(Started):
    """This node acts as a manager that loads slowly, reports causes, and has no bonds."""

    def setUp(self):
        self.requests = queue.Queue()
        self.release = threading.Event()
        self.unloaded = []
        load = rospy.Service("~load_nodelet", NodeletLoad, self.on_load)
        self.addCleanup(load.shutdown)
        unload = rospy.Service("~unload_nodelet", NodeletUnload, self.on_unload)
        self.addCleanup(unload.shutdown)

    def on_load(self, request):
        self.requests.put(request)
        if request.type == "a/Refused":
            raise ValueError('it\'s "so", because…')
        if request.type == "a/Slow":
            self.release.wait(20.0)
        return NodeletLoadResponse(success=request.type != "a/Unlucky")

    def on_unload(self, request):
        self.unloaded.append(request.name)
        return NodeletUnloadResponse(success=True)

    def test_the_request(self):
        self.start(*NODELET, "load", "a/B", rospy.get_name(), "x", "a:=b", "__name:=n", "y")
        request = self.requests.get(timeout=10.0)
        self.assertEqual(request.name, "/n")
        self.assertEqual(request.type, "a/B")
        self.assertEqual(request.remap_source_args, ["/a"])
        self.assertEqual(request.remap_target_args, ["/b"])
        self.assertEqual(request.my_argv, ["x", "y"])
        self.assertRegex(request.bond_id, "^/n_[0-9a-f-]{36}$")

    def test_without_bond_there_is_no_id(self):
        self.start(*NODELET, "load", "a/B", rospy.get_name(), "--no-bond", "x")
        request = self.requests.get(timeout=10.0)
        self.assertEqual(request.name, "/a_B")
        self.assertEqual(request.my_argv, ["x"])
        self.assertEqual(request.bond_id, "")

    def test_the_cause_of_a_refusal_is_shown(self):
        code, output = finished([*NODELET, "load", "a/Refused", rospy.get_name()])
        self.assertEqual(code, 255)
        self.assertIn("': it's \"so\", because…", output)
        self.assertNotIn("b'", output)
        self.assertEqual(finished([*NODELET, "load", "a/Unlucky", rospy.get_name()])[0], 255)

    def test_stopped_while_the_nodelet_initialises(self):
        self.addCleanup(self.release.set)
        process = self.start(*NODELET, "load", "a/Slow", rospy.get_name(), "--no-bond")
        self.requests.get(timeout=10.0)
        process.stop()
        self.assertEqual(process.exit_code(20.0), 130, process.output)
        self.assertEqual(self.unloaded, ["/a_Slow"])

    def test_a_manager_that_ignores_the_bond(self):
        process = self.start(*NODELET, "load", "a/B", rospy.get_name())
        self.requests.get(timeout=10.0)
        start = time.monotonic()
        self.assertEqual(process.exit_code(13.0), 0)
        self.assertGreater(time.monotonic() - start, 9.0)
        self.assertIn("Bond broken, exiting\n", process.output)


if __name__ == "__main__":
    rospy.init_node("nodelet_command_test")
    rostest.rosrun("dyknow", "nodelet_command", "__main__")
