#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`nodelet load` and `unload`: DyKnow's client and nodelet_core's, with managers of both.

`test_nodelet_manager` runs `ClientTest` in the quick run.
"""

from __future__ import annotations

import queue
import signal
import threading
import time

import graph  # first: it makes the test package known
import rospy
import rostest
from graph import Ended, Manager, ManagerServices, NodeletManagerCase, let_the_bond_form
from nodelet.srv import NodeletLoad, NodeletLoadResponse, NodeletUnload, NodeletUnloadResponse
from processes import BUSY, NODELET, STOCK_NODELET, TellingCase, eventually, finished, nodes


class StartingCase(TellingCase):
    def start(self, *command):
        process = Ended(*command)
        self.addCleanup(process.__exit__)
        return process

    def assert_ends(self, process, code=0, within=20.0):
        """It ends by itself, in the time (s) of a quiet machine."""
        self.assertEqual(process.exit_code(within), code, process.output)


class ClientCase(StartingCase):
    """A client loads a nodelet, by default a Relay into DyKnow's manager."""

    clients = {"own": NODELET}
    nodelet_type = "dyknow/Relay"
    namespace = "/robot"

    @property
    def name(self):
        return f"{self.namespace}/nodelet"

    def load(self, *arguments, client="own"):
        names = ("__name:=nodelet", f"__ns:={self.namespace}")
        words = ("load", self.nodelet_type, "manager", *arguments, *names)
        process = self.start(*self.clients[client], *words)
        eventually(lambda: self.manager.list() or process.has_ended, 15.0, "it is loaded")
        self.assertEqual(self.manager.list(), [self.name], process.output)
        return process

    def bonded(self, *arguments, client="own"):
        """Load a nodelet whose bond has formed; the stock client handles signals from then on."""
        process = self.load(*arguments, client=client)
        let_the_bond_form(f"{self.manager.name}/bond")
        return process


class ClientTest(ClientCase, NodeletManagerCase):
    clients = {"own": NODELET, "stock": STOCK_NODELET}
    manager_name = "/robot/manager"

    def each_client(self, *clients):
        for client in clients or self.clients:
            with self.subTest(client):
                yield client
                eventually(lambda: self.manager.list() == [], 6.0, "the nodelet is unloaded")

    def test_signals_unload(self):
        for client in self.each_client():
            # SIGTERM just ends the stock client.
            for number in (signal.SIGINT, signal.SIGTERM)[: 2 if client == "own" else 1]:
                process = self.bonded(client=client)
                process.stop(number)
                self.assert_ends(process)
                eventually(lambda: self.manager.list() == [], 2.0, "the nodelet is unloaded")
                self.assertIn(f"Unloading nodelet {self.name} from manager", process.output)
                eventually(lambda: self.name not in nodes(), 5.0, "the client is gone")

    def test_kill_9_of_the_client_unloads(self):
        for client in self.each_client():
            self.bonded(client=client).stop(signal.SIGKILL)

    def test_rosnode_kill_unloads(self):
        for client in self.each_client("own"):
            process = self.bonded(client=client)
            code, output = finished(["rosnode", "kill", self.name])
            self.assertEqual(code, 0, output)
            self.assert_ends(process)

    def test_the_client_ends_when_others_unload(self):
        for client in self.each_client():
            process = self.bonded(client=client)
            code, output = finished(
                [*self.clients[client], "unload", self.name, self.manager.name]
            )
            self.assertEqual(code, 0, output)
            self.assert_ends(process)
            self.assertIn("Bond broken, exiting", process.output)
            self.assertNotIn("Unloading", process.output)

    def test_a_killed_client_without_bond_leaves_the_nodelet(self):
        for client in self.each_client():
            process = self.load("--no-bond", client=client)
            process.stop(signal.SIGKILL)
            process.exit_code(20.0)
            self.assertEqual(self.manager.list(), [self.name])
            code, output = finished(
                [*self.clients[client], "unload", self.name, self.manager.name]
            )
            self.assertEqual(code, 0, output)

    def test_what_the_manager_refuses(self):
        for client in self.each_client():
            words = [*self.clients[client], "load", "image_proc/nothing", self.manager.name]
            code, output = finished(words)
            self.assertEqual(code, 255, output)
            said = "Failed to load nodelet '/image_proc_nothing` of type `image_proc/nothing` "
            self.assertIn(f"{said}to manager `{self.manager.name}'", output)
            code, output = finished(
                [*self.clients[client], "unload", "/nobody", self.manager.name]
            )
            self.assertEqual(code, 255)
            self.assertIn(
                f"Failed to unload nodelet '/nobody` from manager `{self.manager.name}'", output
            )

    def test_remappings_parameters_and_names(self):
        for client in self.each_client():
            process = self.bonded("in:=cam/in", "out:=/b", "_size:=3", client=client)
            self.assertEqual(
                graph.topics_of_ports(self.name), {"in": "/robot/cam/in", "out": "/b"}
            )
            self.assertEqual(rospy.get_param(f"{self.name}/size"), 3)
            if client == "own":
                self.assertIn("/robot/in -> /robot/cam/in\n", process.output)
            self.assertNotIn("__name", process.output)
            process.stop()
            self.assert_ends(process)


class EndedManagerTest(ClientCase):
    """The manager ends or hangs before the client does."""

    namespace = "/ending"

    def setUp(self):
        self.manager = self.start_manager()
        self.addCleanup(self.manager.__exit__)

    def start_manager(self):
        return Manager(f"{self.namespace}/manager")

    def test_the_client_ends_with_the_manager(self):
        for number in (signal.SIGKILL, signal.SIGINT):
            process = self.bonded()
            self.manager.stop(number)
            self.assert_ends(process)
            self.assertIn("Bond broken, exiting", process.output)
            self.manager.exit_code(20.0)
            self.setUp()

    def test_a_stopped_manager_does_not_hold_up_the_client(self):
        process = self.bonded()
        self.manager.stop(signal.SIGSTOP)
        process.stop()
        self.assert_ends(process)
        self.assertIn("did not answer within 2 s", process.output)
        self.manager.stop(signal.SIGCONT)
        eventually(lambda: self.manager.list() == [], 5.0, "the nodelet is unloaded")

    def test_a_dead_manager_is_no_trouble_at_the_end(self):
        for number, arguments in ((signal.SIGKILL, ()), (signal.SIGINT, ("--no-bond",))):
            process = self.load(*arguments)
            if not arguments:  # so that the client has its answer
                let_the_bond_form(f"{self.manager.name}/bond")
            self.manager.stop(number)
            self.manager.exit_code(20.0)
            process.stop()
            self.assert_ends(process)
            for word in ("Couldn't find", "ERROR", "FATAL", "Traceback"):
                self.assertNotIn(word, process.output)
            self.setUp()

    def test_a_name_that_is_taken_stays_with_the_first(self):
        self.load("--no-bond").stop(signal.SIGKILL)
        names = ("__name:=nodelet", f"__ns:={self.namespace}")
        words = ("load", self.nodelet_type, self.manager.name, *names)
        code, output = finished([*NODELET, *words])
        self.assertEqual(code, 255, output)
        self.assertEqual(self.manager.list(), [self.name])


class StockManager(Ended, ManagerServices):
    """nodelet_core's manager, in C++."""

    def __init__(self, namespace: str) -> None:
        ManagerServices.__init__(self, f"{namespace}/manager")
        super().__init__(*STOCK_NODELET, "manager", "__name:=manager", f"__ns:={namespace}")
        self.wait_until_up()


class StockManagerTest(ClientTest):
    clients = {"own": NODELET}
    nodelet_type = "image_proc/resize"
    namespace = "/stock"

    @classmethod
    def start_manager(cls):
        manager = StockManager(cls.namespace)
        cls.addClassCleanup(manager.__exit__)
        return manager

    def test_remappings_parameters_and_names(self):
        process = self.load("image:=cam/image", "~image:=small", "_scale_width:=0.25")
        published = {topic for topic, _ in rospy.get_published_topics()}
        self.assertIn("/stock/small", published)
        self.assertEqual(rospy.get_param("/stock/nodelet/scale_width"), 0.25)
        for said in (
            "Loading nodelet /stock/nodelet of type image_proc/resize to manager manager "
            "with the following remappings:",
            "/stock/image -> /stock/cam/image\n",
            "/stock/nodelet/image -> /stock/small\n",
        ):
            self.assertIn(said, process.output)


class EndedStockManagerTest(EndedManagerTest):
    nodelet_type = "image_proc/resize"
    namespace = "/ending_stock"

    def start_manager(self):
        return StockManager(self.namespace)


class WaitingTest(StartingCase):
    def test_unload_without_a_manager(self):
        code, output = finished([*NODELET, "unload", "/n", "/nobody"])
        self.assertEqual(code, 255)
        self.assertIn("Unloading nodelet /n from manager /nobody\n", output)
        self.assertIn("Couldn't find service /nobody/unload_nodelet, perhaps the manager", output)

    def test_load_waits_for_the_manager(self):
        process = self.start(*NODELET, "load", "image_proc/resize", "/late", "__name:=early")
        process.wait_for("waitForService: Service [/late/load_nodelet] has not been advertised")
        process.wait_for("Waiting for service /late/load_nodelet to be available for 10 seconds..")
        self.start(*STOCK_NODELET, "manager", "__name:=late")
        process.wait_for("waitForService: Service [/late/load_nodelet] is now available.")
        late = ManagerServices("/late")
        eventually(lambda: late.list() == ["/early"], 10.0, "the nodelet is loaded")

    def test_a_client_that_waits_can_be_stopped(self):
        for stop in (
            lambda process: process.stop(signal.SIGINT),
            lambda process: process.stop(signal.SIGTERM),
            lambda process: finished(["rosnode", "kill", "/waiting"]),
        ):
            process = self.start(*NODELET, "load", "a/B", "/nobody", "__name:=waiting")
            process.wait_for("has not been advertised, waiting...")
            stop(process)
            self.assert_ends(process, 130)
            self.assertNotIn("Unloading", process.output)
            self.assertNotIn("Traceback", process.output)


class OddManagerTest(StartingCase):
    """This node acts as a manager that loads slowly, reports causes, and has no bonds."""

    def setUp(self):
        self.requests = queue.Queue()
        self.release = threading.Event()
        self.addCleanup(self.release.set)
        self.unloaded = []
        for service in (
            rospy.Service("~load_nodelet", NodeletLoad, self.on_load),
            rospy.Service("~unload_nodelet", NodeletUnload, self.on_unload),
        ):
            self.addCleanup(service.shutdown)

    def on_load(self, request):
        self.requests.put(request)
        if request.type == "a/Refused":
            raise ValueError('it\'s "so", because…')
        if request.type == "a/Slow":
            self.release.wait(20.0 * BUSY)
        return NodeletLoadResponse(success=request.type != "a/Unlucky")

    def on_unload(self, request):
        self.unloaded.append(request.name)
        return NodeletUnloadResponse(success=True)

    def requested(self, *words):
        """Start a client; returns its request and its process."""
        process = self.start(*NODELET, "load", words[0], rospy.get_name(), *words[1:])
        return self.requests.get(timeout=10.0 * BUSY), process

    def test_the_request(self):
        request, _ = self.requested("a/B", "x", "a:=b", "__name:=n", "y")
        self.assertEqual((request.name, request.type), ("/n", "a/B"))
        self.assertEqual((request.remap_source_args, request.remap_target_args), (["/a"], ["/b"]))
        self.assertEqual(request.my_argv, ["x", "y"])
        self.assertRegex(request.bond_id, "^/n_[0-9a-f-]{36}$")
        request, _ = self.requested("a/B", "--no-bond", "x")
        self.assertEqual((request.name, request.my_argv, request.bond_id), ("/a_B", ["x"], ""))

    def test_the_cause_of_a_refusal_is_shown(self):
        code, output = finished([*NODELET, "load", "a/Refused", rospy.get_name()])
        self.assertEqual(code, 255)
        self.assertIn("': it's \"so\", because…", output)
        self.assertNotIn("b'", output)
        self.assertEqual(finished([*NODELET, "load", "a/Unlucky", rospy.get_name()])[0], 255)

    def test_stopped_while_the_nodelet_initialises(self):
        _, process = self.requested("a/Slow", "--no-bond")
        process.stop()
        self.assert_ends(process, 130)
        self.assertEqual(self.unloaded, ["/a_Slow"])

    def test_a_manager_that_ignores_the_bond(self):
        _, process = self.requested("a/B")
        start = time.monotonic()
        self.assert_ends(process)
        self.assertGreater(time.monotonic() - start, 9.0)
        self.assertIn("Bond broken, exiting", process.output)


if __name__ == "__main__":
    rospy.init_node("nodelet_command_test")
    rostest.rosrun("dyknow", "nodelet_command", "__main__")
