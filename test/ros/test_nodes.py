#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Unchanged programs as nodes, and nodelets that other clients have loaded."""

from __future__ import annotations

import signal
import tempfile
from pathlib import Path

import graph
import psutil
import rospy
from cpp_suite import OURS, PRELOADED, RUN, CppManager
from graph import Manager, WordsCase, connect, hears
from manager_suite import CHILD, ManagerCase, library, parameters, registrations, specification
from manager_suite import LIBRARY as NODELETS
from processes import (
    BUSY,
    DYKNOW,
    NODELET,
    STOCK_NODELET,
    Done,
    Running,
    becomes,
    eventually,
    finished,
    run,
)

from dyknow.cli.shell import INTERRUPTED
from dyknow.errors import Refused
from dyknow.manager.specifications.specification import parse
from dyknow.model.graph import NodeletKind, State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.model.transformation import Parameter, Port, Transformation
from dyknow.ros.process.os_process import ProcessId

BY_HAND = (Port("/b", "in", tags=("Words(?x)",)), Port("/spoken", "out", tags=("Spoken(?x)",)))
LIBRARY = library(
    specification(
        "copier", "topic_tools/relay words copy", ">words copy>", "node", unreliable=False
    ),
    specification("usage", "topic_tools/throttle", ">words", "node"),
    specification("shell script", "dyknow_manager_test/greet.sh", "", "node"),
    specification("talker", "dyknow_test/talker.py --word moin", "words>", "node"),
    specification("left words", "/a", "a>=Words(left)", "topic"),
    Transformation("by hand", "", "node", ports=BY_HAND, node="/by_hand").to_xml(),
)
RATE = Parameter("rate", "int", "30")
PROBE = (*DYKNOW, "probe")
THEIRS = "/robot/dyknow_manager"
RELAY = "dyknow_manager_test/Relay"


class GuardedCase(ManagerCase):
    """Beside a DyKnow manager, which did not start them."""

    def setUp(self) -> None:
        super().setUp()
        self.manager = self.started(denied_topics=["/estop"])
        self.client = self.manager.client

    def shown(self, name: str):
        eventually(lambda: self.manager.nodelet(name), 10.0, f"{name} is in the model")
        return self.manager.nodelet(name)

    def connect(self, nodelet: str, config: dict[str, str]) -> None:
        self.client.connect([(nodelet, config)])


class NodesTest(WordsCase, GuardedCase):
    """Nodes that the manager starts."""

    def setUp(self) -> None:
        super().setUp()
        self.client.add_transformation(LIBRARY)

    def process(self, name: str) -> ProcessId:
        return self.manager.child(name)

    def runs(self, name: str, **topics: str) -> None:
        """The model shows that it runs, and where its ports are."""

        def shown() -> tuple[bool, dict[str, str]]:
            found = self.manager.nodelet(name)
            return found is not None and found.state is State.RUNNING, self.manager.topics(name)

        becomes(shown, (True, topics))

    def is_gone(self, name: str) -> None:
        """Nothing of it is left."""
        self.assertIsNone(self.manager.nodelet(name))
        becomes(lambda: registrations(name) + parameters(name), [])

    def killed(self, name: str) -> None:
        """Kill its process; it is started again."""
        process = self.process(name)
        process.signal(signal.SIGKILL)
        eventually(lambda: self.process(name) != process, 10.0, "it is started again")

    def restart(self) -> None:
        """Kill the manager and start it again."""
        self.manager.kill()
        self.manager.start()

    def test_the_life_of_a_binary(self) -> None:
        client, name = self.manager.client, "/robot/copier"
        given = (Parameter("lazy", "bool", "false"),)
        client.spawn("copier", name, {"words": "/a", "copy": "/out"}, parameters=given)
        hears("/out", "left")
        node = self.manager.nodelet(name)
        self.assertEqual((node.kind, node.manager), (NodeletKind.CPP_NODE, ""))
        self.assertEqual((node.transformation, node.parameters), ("copier", given))
        self.runs(name, words="/a", copy="/out")
        self.assertEqual(rospy.get_param(name)["lazy"], False)

        client.set_config(name, {"words": "/b"})
        hears("/out", "right")
        self.killed(name)
        hears("/out", "right")
        self.runs(name, words="/b", copy="/out")
        process = self.process(name)
        self.restart()
        self.runs(name, words="/b", copy="/out")
        self.assertEqual(self.process(name), process)
        client.set_config(name, {"words": "/a"})
        hears("/out", "left")
        client.destroy(name)
        self.assertFalse(process.alive)
        self.is_gone(name)

        with self.assertRaisesRegex(Refused, "ended at its start; the last that it printed"):
            client.spawn("usage", "/usage")
        with self.assertRaisesRegex(Refused, "greet.sh' is neither a Python script nor a binary"):
            client.spawn("shell script", "/greeter")
        self.is_gone("/usage")

    def test_the_life_of_a_script(self) -> None:
        client = self.manager.client
        for name, isolated, kind, host in (
            ("/shared", False, NodeletKind.SCRIPT, CHILD),
            ("/alone", True, NodeletKind.NODE, ""),
        ):
            with self.subTest(name):
                client.spawn(
                    "talker", name, {"words": "/said"}, isolated=isolated, parameters=(RATE,)
                )
                hears("/said", "moin")
                node = self.manager.nodelet(name)
                self.assertEqual((node.kind, node.manager, node.isolated), (kind, host, isolated))
                self.assertEqual(rospy.get_param(f"{name}/rate"), 30)
                client.set_config(name, {"words": "/elsewhere"})
                hears("/elsewhere", "moin")
                self.runs(name, words="/elsewhere")
                self.killed(host or name)
                hears("/elsewhere", "moin")
                self.runs(name, words="/elsewhere")
                client.destroy(name)
                self.is_gone(name)

    def test_nodes_end_with_the_manager_and_when_nobody_looks_after_them(self) -> None:
        self.client.spawn("copier", "/last", {"words": "/a", "copy": "/last/out"})
        last = self.process("/last")
        self.manager.stop()
        self.assertFalse(last.alive)
        becomes(lambda: registrations("/last"), [])
        self.manager.parameters["orphan_timeout"] = 3.0
        self.manager.start()
        self.manager.client.spawn("copier", "/binary")
        self.manager.client.spawn("talker", "/script", isolated=True)
        processes = [self.process(name) for name in ("/binary", "/script")]
        self.manager.kill()
        for process in processes:
            self.assertTrue(process.wait(5.0 * BUSY))

    def test_a_node_of_others_supplies_and_demands(self) -> None:
        client = self.manager.client
        command = (*RUN, "topic_tools", "relay", "/b", "/spoken", "__name:=by_hand")
        with graph.Ended(*command):
            self.runs("/by_hand", **{"/b": "/b", "/spoken": "/spoken"})
            self.assertEqual(self.manager.nodelet("/by_hand").transformation, "by hand")
            hears("/spoken", "right")
            found = client.acquire_stream(StreamRequest("Spoken(left)"))
            self.assertEqual((found.reused, found.topic), (("/by_hand",), "/spoken"))
            hears("/spoken", "left")
            self.restart()
            becomes(lambda: [each.state for each in client.list_streams()], [ClaimState.ACTIVE])
            (stream,) = client.list_streams()
            self.assertEqual(stream.nodelets, ("/by_hand",))
            self.assertNotIn("is gone", stream.detail)
            with self.assertRaisesRegex(Refused, "process of its own"):
                client.destroy("/by_hand")
        becomes(lambda: [each.state for each in client.list_streams()], [ClaimState.PENDING])
        becomes(lambda: self.manager.nodelet("/by_hand"), None)

    def test_a_specification_to_begin_with(self) -> None:
        words = ("topic_tools", "relay", "/a", "/probed", "_lazy:=false")
        code, printed = finished([*PROBE, "--settle", "3", *words])
        self.assertEqual(code, 0, printed)
        ports = (Port("/a", "in"), Port("/probed", "out", "std_msgs/String"))  # in: of any type
        given = (Parameter("lazy", "bool", "false"),)
        relay = Transformation("relay", "topic_tools/relay /a /probed", "node", 1, given, ports)
        self.assertEqual(parse(printed).transformations, (relay,))
        self.assertEqual(self.manager.client.add_transformation(printed).labels, ("relay",))
        # A manager listens to it for a moment longer.
        becomes(lambda: registrations("/dyknow_probe") + parameters("/dyknow_probe"), [])
        code, printed = finished([*PROBE, "topic_tools", "throttle"])
        self.assertEqual(code, 1)
        self.assertIn("the node ended by itself; it printed at last:", printed)

    def test_a_probe_that_is_ended_ends_its_node(self) -> None:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            with Running(*PROBE, "--settle", "600", "topic_tools", "relay", "/a", "/b") as probe:
                eventually(lambda: registrations("/dyknow_probe"), 30.0, "its node is up")
                (process,) = psutil.Process(probe.pid).children()
                probe.stop(number)
                self.assertEqual(probe.exit_code(10.0), INTERRUPTED, probe.output)
            self.assertFalse(process.is_running())
            becomes(lambda: registrations("/dyknow_probe") + parameters("/dyknow_probe"), [])


class ForeignTest(GuardedCase):
    """Started by hand: nodelet managers in Python and C++, a nodelet alone, a DyKnow manager."""

    def rewired(self, nodelet: str, port: str, topic: str) -> None:
        self.client.connect([(nodelet, {port: topic})])
        self.assertEqual(self.manager.topics(nodelet)[port], topic)

    def test_nodelets_in_a_nodelet_manager_in_python(self):
        theirs = self.enter(Manager("/my_manager"))
        loading = (*STOCK_NODELET, "load", RELAY, "my_manager", "__name:=bonded")
        self.run_process(*loading)
        theirs.load(RELAY, "/by_hand")
        for name, owner in (("/bonded", "/bonded"), ("/by_hand", rospy.get_name())):
            found = self.shown(name)
            self.assertEqual((found.manager, found.owner), ("/my_manager", owner))
            self.assertEqual((found.kind, found.state), (NodeletKind.PYTHON, State.RUNNING))
        printed = Done("list", "-l").out
        self.assertRegex(printed, r"/bonded +\(by /bonded\) +running +1 +1( +\S+){3} +/my_manager")
        self.assertIn("Owner: /bonded", Done("info", "bonded").out)

        self.client.spawn("counter", "/counter", {"out": "/numbers"})
        self.rewired("/by_hand", "in", "/numbers")
        self.rewired("/by_hand", "out", "/passed")
        eventually(
            lambda: self.client.get_statistics("/by_hand").ports[1].messages > 0,
            10.0,
            "messages pass",
        )
        with self.assertRaisesRegex(Refused, "nodelet unload /by_hand /my_manager"):
            self.client.destroy("/by_hand")
        with self.assertRaisesRegex(Refused, "restart it where it was started"):
            self.client.restart("/by_hand")
        with self.assertRaisesRegex(Refused, "unknown nodelet manager '/my_manager'; known"):
            self.client.spawn("relay", "/mine", manager="/my_manager")

        self.manager.kill()
        self.manager.start()
        self.assertEqual(self.shown("/by_hand").owner, rospy.get_name())
        code, printed = finished([*NODELET, "unload", "/by_hand", "my_manager"])
        self.assertEqual(code, 0, printed)
        becomes(lambda: self.manager.nodelet("/by_hand"), None)
        theirs.stop(signal.SIGKILL)
        becomes(lambda: self.manager.nodelet("/bonded"), None)
        self.assertEqual(self.manager.nodelet("/counter").state, State.RUNNING)

    def test_nodelets_in_nodelet_managers_in_cpp(self):
        for name, command in (("/ours", ()), ("/stock", PRELOADED)):
            with self.subTest(name):
                theirs = self.enter(CppManager(name, *command))
                sink = f"{name}_sink"
                theirs.load("Sink", sink)
                found = self.shown(sink)
                self.assertEqual((found.manager, found.owner), (name, rospy.get_name()))
                self.assertEqual((found.kind, found.is_fixed), (NodeletKind.CPP, False))
                self.rewired(sink, found.ports[0].name, f"{name}/elsewhere")
                with self.assertRaisesRegex(Refused, f"nodelet unload {sink} {name}"):
                    self.client.destroy(sink)
                self.assertEqual(theirs.list(), [sink])
                theirs.unload(sink)
                becomes(lambda sink=sink: self.manager.nodelet(sink), None)

    def test_the_nodelets_of_another_dyknow_manager(self):
        theirs = self.make(THEIRS)
        theirs.start()
        theirs.client.add_transformation(NODELETS)
        theirs.client.spawn("relay", "/shared")
        theirs.client.spawn("relay", "/alone", isolated=True)
        for name in ("/shared", "/alone"):
            self.assertEqual(self.shown(name).owner, THEIRS)
            self.assertEqual(theirs.nodelet(name).owner, "")
        self.client.connect([("/shared", {"in": "/from_here"})])
        becomes(lambda: theirs.topics("/shared")["in"], "/from_here")
        with self.assertRaisesRegex(Refused, f"of {THEIRS}; end it with"):
            self.client.destroy("/shared")
        theirs.client.destroy("/alone")
        becomes(lambda: self.manager.nodelet("/alone"), None)

    def test_a_nodelet_alone(self):
        process = self.run_process(*NODELET, "standalone", RELAY, "__name:=alone")
        found = self.shown("/alone")
        self.assertEqual((found.kind, found.manager), (NodeletKind.NODE, ""))
        self.rewired("/alone", "in", "/a")
        with self.assertRaisesRegex(Refused, "rosnode kill /alone"):
            self.client.destroy("/alone")
        process.stop(signal.SIGKILL)
        becomes(lambda: self.manager.nodelet("/alone"), None)

    def test_guards_of_this_manager_do_not_bind_processes_of_other_clients(self):
        theirs = self.enter(Manager("/my_manager"))
        theirs.load(RELAY, "/early")
        self.shown("/early")
        with self.assertRaisesRegex(Refused, "'/estop' is denied"):
            self.client.connect([("/early", {"in": "/estop"})])
        theirs.load(RELAY, "/late", {"/in": "/estop"})
        becomes(lambda: self.manager.topics("/late").get("in"), "/estop")

    def test_an_owner_that_allows_no_rewiring(self):
        for name, command, kind, port in (
            ("/python", (*NODELET, "manager", "_rewirable:=false"), RELAY, "in"),
            ("/cpp", (*OURS, "_rewirable:=false"), "dyknow_cpp_test/Sink", "in"),
        ):
            with self.subTest(name):
                self.enter(Manager(name, command=command)).load(kind, f"{name}_nodelet")
                before = self.shown(f"{name}_nodelet").ports
                for connect in (self.client.set_config, self.connect):
                    with self.assertRaisesRegex(Refused, "not to be re-wired .*~rewirable"):
                        connect(f"{name}_nodelet", {port: "/a"})
                self.assertEqual(self.manager.nodelet(f"{name}_nodelet").ports, before)


class OthersTest(WordsCase, GuardedCase):
    """Nodes of roscpp."""

    def test_a_relay_is_shown_and_rewired(self):
        process = self.run_process(*RUN, "topic_tools", "relay", "/a", "/out", "__name:=copier")
        hears("/out", "left", is_whole=True)
        node = self.shown("/copier")
        self.assertEqual(
            (node.kind, node.manager, node.transformation), (NodeletKind.CPP_NODE, "", "")
        )
        becomes(lambda: self.manager.topics("/copier"), {"/a": "/a", "/out": "/out"})
        self.manager.client.set_config("/copier", {"/a": "/b"})
        hears("/out", "right", is_whole=True)
        becomes(lambda: self.manager.topics("/copier"), {"/a": "/b", "/out": "/out"})
        self.manager.client.set_config("/copier", {"/out": "/elsewhere"})
        hears("/elsewhere", "right", is_whole=True)
        with self.assertRaisesRegex(Refused, "'/estop' is denied"):
            self.manager.client.set_config("/copier", {"/out": "/estop"})
        with self.assertRaisesRegex(Refused, "process of its own; end it with: rosnode kill"):
            self.manager.client.destroy("/copier")
        process.stop()
        self.assertEqual(process.exit_code(5.0), 0)
        becomes(lambda: self.manager.nodelet("/copier"), None)
        self.assertEqual(graph.registrations("/copier")["publishers"], [])

    def test_owners_that_allow_no_rewiring(self):
        for name, words in (
            ("/copier", ("topic_tools", "relay", "/a", "/out")),
            ("/alone", ("nodelet", "nodelet", "standalone", "dyknow_cpp_test/Eager", "/in:=/a")),
        ):
            with self.subTest(name):
                words = (*words, "_rewirable:=false", f"__name:={name[1:]}")
                process = self.run_process(*RUN, *words)
                eventually(lambda name=name: self.shown(name).ports, 10.0, "it has ports")
                port = next(each.name for each in self.shown(name).ports if each.topic == "/a")
                for set_config in (self.client.set_config, self.connect):
                    with self.assertRaisesRegex(Refused, "not to be re-wired .*~rewirable"):
                        set_config(name, {port: "/b"})
                self.assertEqual(self.manager.topics(name)[port], "/a")
                process.stop()
                self.assertEqual(process.exit_code(5.0), 0)

    def test_a_node_is_shown_while_it_runs_whichever_side_began_first(self):
        words = ("throttle", "messages", "/a", "20", "/slow", "__name:=slow")
        process = self.run_process(*RUN, "topic_tools", *words)
        hears("/slow", "left", is_whole=True)
        self.shown("/slow")
        process.stop(signal.SIGKILL)
        becomes(lambda: self.manager.nodelet("/slow"), None)
        self.run_process(*RUN, "topic_tools", *words)
        self.shown("/slow")
        self.manager.kill()
        self.manager.start()
        self.shown("/slow")

    def test_a_launch_file_with_a_prefix(self):
        text = """
            <launch>
              <group ns="robot">
                <node name="mux" pkg="topic_tools" type="mux" args="/out /a /b"
                      launch-prefix="rosrun dyknow rewirable" output="screen"/>
              </group>
            </launch>"""
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "mux.launch"
            file.write_text(text)
            self.run_process("roslaunch", str(file))
            hears("/out", "left", is_whole=True)
            self.shown("/robot/mux")
            connect("/robot/mux", **{"/a": "/b"})
            hears("/out", "right", is_whole=True)


if __name__ == "__main__":
    run()
