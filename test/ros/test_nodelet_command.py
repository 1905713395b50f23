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
from cpp_suite import STOCK
from graph import Manager, NodeletManagerCase, let_the_bond_form
from nodelet.srv import NodeletLoad, NodeletLoadResponse, NodeletUnload, NodeletUnloadResponse
from processes import BUSY, NODELET, STOCK_NODELET, TellingCase, becomes, eventually, finished, run


class CommandCase(TellingCase):
    def ends(self, process, code=0):
        """It ends by itself."""
        self.assertEqual(process.exit_code(20.0), code, process.output)

    def does(self, *command, code=0):
        """A command ends with a code; returns its output."""
        found, output = finished(command)
        self.assertEqual(found, code, output)
        return output


class ClientCase(CommandCase):
    """A client loads a nodelet, by default a Relay into DyKnow's manager."""

    clients = {"own": NODELET}
    nodelet_type = "dyknow/Relay"
    namespace = "/robot"

    @property
    def name(self):
        return f"{self.namespace}/nodelet"

    @property
    def names(self):
        return ("__name:=nodelet", f"__ns:={self.namespace}")

    def load(self, *arguments, client="own"):
        words = ("load", self.nodelet_type, "manager", *arguments, *self.names)
        process = self.run_process(*self.clients[client], *words)
        eventually(lambda: self.manager.list() or process.has_ended, 15.0, "it is loaded")
        self.assertEqual(self.manager.list(), [self.name], process.output)
        return process

    def bonded(self, *arguments, client="own"):
        """Load a nodelet whose bond has formed; the stock client handles signals from then on."""
        process = self.load(*arguments, client=client)
        let_the_bond_form(f"{self.manager.name}/bond")
        return process

    def unloaded(self):
        becomes(self.manager.list, [])


class ClientTest(ClientCase, NodeletManagerCase):
    clients = {"own": NODELET, "stock": STOCK_NODELET}
    manager_name = "/robot/manager"

    def test_signals_unload(self):
        # SIGTERM just ends the stock client.
        numbers = {"own": (signal.SIGINT, signal.SIGTERM), "stock": (signal.SIGINT,)}
        for client, number in [(each, n) for each in self.clients for n in numbers[each]]:
            process = self.bonded(client=client)
            process.stop(number)
            self.ends(process)
            self.unloaded()
            self.assertIn(f"Unloading nodelet {self.name} from manager", process.output)
            becomes(lambda: graph.registered(self.name), set())

    def test_kill_9_of_the_client_unloads(self):
        for client in self.clients:
            process = self.bonded(client=client)
            process.stop(signal.SIGKILL)
            self.unloaded()
            process.__exit__()  # so that its name is forgotten

    def test_rosnode_kill_unloads(self):
        process = self.bonded()
        self.does("rosnode", "kill", self.name)
        self.ends(process)
        self.unloaded()

    def test_the_client_ends_when_others_unload(self):
        for client, command in self.clients.items():
            process = self.bonded(client=client)
            self.does(*command, "unload", self.name, self.manager.name)
            self.ends(process)
            self.assertIn("Bond broken, exiting", process.output)
            self.assertNotIn("Unloading", process.output)

    def test_a_killed_client_without_bond_leaves_the_nodelet(self):
        for client, command in self.clients.items():
            process = self.load("--no-bond", client=client)
            process.stop(signal.SIGKILL)
            process.__exit__()
            self.assertEqual(self.manager.list(), [self.name])
            self.does(*command, "unload", self.name, self.manager.name)
            self.unloaded()

    def test_what_the_manager_refuses(self):
        manager = self.manager.name
        for command in self.clients.values():
            output = self.does(*command, "load", "image_proc/nothing", manager, code=255)
            said = "Failed to load nodelet '/image_proc_nothing` of type `image_proc/nothing` "
            self.assertIn(f"{said}to manager `{manager}'", output)
            output = self.does(*command, "unload", "/nobody", manager, code=255)
            self.assertIn(f"Failed to unload nodelet '/nobody` from manager `{manager}'", output)

    def test_remappings_parameters_and_names(self):
        for client in self.clients:
            process = self.bonded("in:=cam/in", "out:=/b", "_size:=3", client=client)
            topics = graph.topics_of_ports(self.name)
            self.assertEqual(topics, {"in": "/robot/cam/in", "out": "/b"})
            self.assertEqual(rospy.get_param(f"{self.name}/size"), 3)
            if client == "own":
                self.assertIn("/robot/in -> /robot/cam/in\n", process.output)
            self.assertNotIn("__name", process.output)
            process.stop()
            self.ends(process)
            self.unloaded()


class EndedManagerTest(ClientCase):
    """The manager ends or hangs before the client does."""

    namespace = "/ending"
    command = (*NODELET, "manager")

    def setUp(self):
        self.manager = self.enter(Manager(f"{self.namespace}/manager", command=self.command))

    def test_the_client_ends_with_the_manager(self):
        for number in (signal.SIGKILL, signal.SIGINT):
            process = self.bonded()
            self.manager.stop(number)
            self.ends(process)
            self.assertIn("Bond broken, exiting", process.output)
            self.manager.exit_code(20.0)
            self.setUp()

    def test_a_stopped_manager_does_not_hold_up_the_client(self):
        process = self.bonded()
        self.manager.stop(signal.SIGSTOP)
        process.stop()
        self.ends(process)
        self.assertIn("did not answer within 2 s", process.output)
        self.manager.stop(signal.SIGCONT)
        self.unloaded()

    def test_a_dead_manager_is_no_trouble_at_the_end(self):
        for number, load in (
            (signal.SIGKILL, self.bonded),
            (signal.SIGINT, lambda: self.load("--no-bond")),
        ):
            process = load()
            self.manager.stop(number)
            self.manager.exit_code(20.0)
            process.stop()
            self.ends(process)
            for word in ("Couldn't find", "ERROR", "FATAL", "Traceback"):
                self.assertNotIn(word, process.output)
            self.setUp()

    def test_a_name_that_is_taken_stays_with_the_first(self):
        self.load("--no-bond").stop(signal.SIGKILL)
        self.does(*NODELET, "load", self.nodelet_type, self.manager.name, *self.names, code=255)
        self.assertEqual(self.manager.list(), [self.name])


class StockManagerTest(ClientTest):
    clients = {"own": NODELET}
    nodelet_type = "image_proc/resize"
    namespace = "/stock"
    manager_name = "/stock/manager"

    @classmethod
    def start_manager(cls):
        manager = Manager(cls.manager_name, command=STOCK)
        cls.addClassCleanup(manager.__exit__)
        return manager

    def nothing_is_left(self):
        """It keeps its registrations for bonds."""

    def test_remappings_parameters_and_names(self):
        process = self.load("image:=cam/image", "~image:=small", "_scale_width:=0.25")
        self.assertIn("publishers /stock/small", graph.registered(self.manager_name))
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
    command = STOCK


class WaitingTest(CommandCase):
    def test_unload_without_a_manager(self):
        output = self.does(*NODELET, "unload", "/n", "/nobody", code=255)
        self.assertIn("Unloading nodelet /n from manager /nobody\n", output)
        self.assertIn("Couldn't find service /nobody/unload_nodelet, perhaps the manager", output)

    def test_load_waits_for_the_manager(self):
        process = self.run_process(*NODELET, "load", "image_proc/resize", "/late", "__name:=early")
        process.wait_for("waitForService: Service [/late/load_nodelet] has not been advertised")
        process.wait_for("Waiting for service /late/load_nodelet to be available for 10 seconds..")
        late = self.enter(Manager("/late", command=STOCK))
        process.wait_for("waitForService: Service [/late/load_nodelet] is now available.")
        becomes(late.list, ["/early"])

    def test_a_client_that_waits_can_be_stopped(self):
        for stop in (
            lambda process: process.stop(signal.SIGINT),
            lambda process: process.stop(signal.SIGTERM),
            lambda process: finished(["rosnode", "kill", "/waiting"]),
        ):
            process = self.run_process(*NODELET, "load", "a/B", "/nobody", "__name:=waiting")
            process.wait_for("has not been advertised, waiting...")
            stop(process)
            self.ends(process, 130)
            self.assertNotIn("Unloading", process.output)
            self.assertNotIn("Traceback", process.output)


class OddManagerTest(CommandCase):
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
        process = self.run_process(*NODELET, "load", words[0], rospy.get_name(), *words[1:])
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
        output = self.does(*NODELET, "load", "a/Refused", rospy.get_name(), code=255)
        self.assertIn("': it's \"so\", because…", output)
        self.assertNotIn("b'", output)
        self.does(*NODELET, "load", "a/Unlucky", rospy.get_name(), code=255)

    def test_stopped_while_the_nodelet_initialises(self):
        _, process = self.requested("a/Slow", "--no-bond")
        process.stop()
        self.ends(process, 130)
        self.assertEqual(self.unloaded, ["/a_Slow"])

    def test_a_manager_that_ignores_the_bond(self):
        start = time.monotonic()
        _, process = self.requested("a/B")
        self.ends(process)
        self.assertGreater(time.monotonic() - start, 9.0)
        self.assertIn("Bond broken, exiting", process.output)


if __name__ == "__main__":
    run()
