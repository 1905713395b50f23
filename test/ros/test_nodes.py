#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Unchanged programs as nodes: those that the manager starts, and those that it finds."""

from __future__ import annotations

import signal
import tempfile
from pathlib import Path

import graph
import rospy
from cpp_suite import RUN
from graph import WordsCase, connect, hears
from manager_suite import CHILD, ManagerCase, library, parameters, registrations, specification
from processes import BUSY, DYKNOW, becomes, eventually, finished, run

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


class NodesTest(WordsCase, ManagerCase):
    """One manager lives through all of it, since each start takes its time."""

    def setUp(self) -> None:
        super().setUp()
        self.manager = self.started()
        self.manager.client.add_transformation(LIBRARY)

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

        client.spawn("copier", "/last", {"words": "/a", "copy": "/last/out"})
        last = self.process("/last")
        self.manager.stop()
        self.assertFalse(last.alive)
        becomes(lambda: registrations("/last"), [])

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

    def test_nodes_end_when_nobody_looks_after_them(self) -> None:
        self.manager.stop()
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


class OthersTest(WordsCase, ManagerCase):
    """Nodes of roscpp beside a DyKnow manager, which did not start them."""

    def setUp(self):
        super().setUp()
        self.manager = self.started(denied_topics=["/estop"])

    def shown(self, name: str):
        eventually(lambda: self.manager.nodelet(name), 10.0, f"{name} is in the model")
        return self.manager.nodelet(name)

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
