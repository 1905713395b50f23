#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Unchanged programs that the manager starts as nodes, restores, adopts and ends."""

from __future__ import annotations

import signal
import time

import graph
import rospy
import rostest
from cpp_suite import RUN
from graph import Talker, hears
from manager_suite import CHILD, ManagerCase, parameters, registrations
from processes import BUSY, DYKNOW, eventually, finished

from dyknow.errors import Refused
from dyknow.manager.specifications.specification import parse
from dyknow.model.graph import NodeletKind, State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.model.transformation import Parameter, Port, Transformation
from dyknow.ros.process.os_process import ProcessId

LIBRARY = """
<transformations>
  <transformation type="node">
    <label>copier</label>
    <source>topic_tools/relay words copy</source>
    <params><param name="unreliable" type="bool">false</param></params>
    <ports><port type="in">words</port><port type="out">copy</port></ports>
  </transformation>
  <transformation type="node">
    <label>usage</label>
    <source>topic_tools/throttle</source>
    <ports><port type="in">words</port></ports>
  </transformation>
  <transformation type="node">
    <label>shell script</label>
    <source>dyknow_manager_test/greet.sh</source>
  </transformation>
  <transformation type="node">
    <label>talker</label>
    <source>dyknow_test/talker.py --word moin</source>
    <ports><port type="out" datatype="std_msgs/String">words</port></ports>
  </transformation>
  <transformation type="node" node="/by_hand">
    <label>by hand</label>
    <ports><port type="in">/b</port><port type="out">/spoken</port></ports>
    <tags><tag port="/b">Words(?x)</tag><tag port="/spoken">Spoken(?x)</tag></tags>
  </transformation>
  <transformation type="topic">
    <label>left words</label><source>/a</source>
    <ports><port type="out">a</port></ports><tags><tag port="a">Words(left)</tag></tags>
  </transformation>
</transformations>"""


RATE = Parameter("rate", "int", "30")
PROBE = (*DYKNOW, "probe")


class NodesTest(ManagerCase):
    """One manager lives through all of it, since each start takes its time."""

    def setUp(self) -> None:
        for topic, word in (("/a", "left"), ("/b", "right")):
            talker = Talker(topic, word)
            self.addCleanup(talker.close)
        self.manager = self.started()
        self.manager.client.add_transformation(LIBRARY)

    def process(self, name: str) -> ProcessId:
        return self.manager.child(name)

    def runs(self, name: str) -> bool:
        found = self.manager.nodelet(name)
        return found is not None and found.state is State.RUNNING

    def shows(self, name: str, topics: dict[str, str]) -> None:
        eventually(
            lambda: self.manager.topics(name) == topics,
            10.0,
            f"the model shows where the ports of {name} are",
            lambda: self.manager.nodelet(name),
        )

    def test_the_life_of_a_binary(self) -> None:
        client, name = self.manager.client, "/robot/copier"
        config = {"words": "/a", "copy": "/out"}
        given = (Parameter("lazy", "bool", "false"),)
        client.spawn("copier", name, config, parameters=given)
        hears("/out", "left")
        node = self.manager.nodelet(name)
        self.assertEqual((node.kind, node.manager), (NodeletKind.CPP_NODE, ""))
        self.assertEqual((node.transformation, node.parameters), ("copier", given))
        self.assertEqual(self.manager.topics(name), config)
        self.assertEqual(rospy.get_param(name)["lazy"], False)

        client.set_config(name, {"words": "/b"})
        hears("/out", "right")
        self.shows(name, {"words": "/b", "copy": "/out"})

        killed = self.process(name)
        killed.signal(signal.SIGKILL)
        eventually(lambda: self.process(name) != killed, 5.0, "it is started again")
        hears("/out", "right")
        eventually(lambda: self.runs(name), 5.0, "it is shown")
        self.assertEqual(self.manager.topics(name), {"words": "/b", "copy": "/out"})

        process = self.process(name)
        self.manager.kill()
        self.manager.start()
        self.assertTrue(self.runs(name))
        self.assertEqual(self.process(name), process)
        client.set_config(name, {"words": "/a"})
        hears("/out", "left")

        client.destroy(name)
        self.assertFalse(process.alive)
        self.assertIsNone(self.manager.nodelet(name))
        self.assertEqual(registrations(name), [])
        self.assertEqual(parameters(name), [])

        with self.assertRaisesRegex(Refused, "ended at its start; the last that it printed"):
            client.spawn("usage", "/usage")
        with self.assertRaisesRegex(Refused, "greet.sh' is neither a Python script nor a binary"):
            client.spawn("shell script", "/greeter")
        self.assertEqual(parameters("/usage"), [])

        client.spawn("copier", "/last", {"words": "/a", "copy": "/last/out"})
        last = self.process("/last")
        self.manager.stop()
        self.assertFalse(last.alive)
        self.assertEqual(registrations("/last"), [])

    def test_the_life_of_a_script(self) -> None:
        client = self.manager.client
        client.spawn("talker", "/shared", {"words": "/said"}, parameters=(RATE,))
        hears("/said", "moin")
        node = self.manager.nodelet("/shared")
        self.assertEqual((node.kind, node.manager), (NodeletKind.SCRIPT, CHILD))
        self.assertEqual(rospy.get_param("/shared/rate"), 30)
        client.set_config("/shared", {"words": "/elsewhere"})
        hears("/elsewhere", "moin")
        self.shows("/shared", {"words": "/elsewhere"})

        self.manager.kill_child()
        hears("/elsewhere", "moin")
        eventually(lambda: self.runs("/shared"), 5.0, "it is shown")
        self.assertEqual(self.manager.topics("/shared"), {"words": "/elsewhere"})
        client.destroy("/shared")
        self.assertEqual(registrations("/shared"), [])

        client.spawn("talker", "/alone", {"words": "/said"}, isolated=True)
        hears("/said", "moin")
        alone = self.manager.nodelet("/alone")
        self.assertEqual((alone.kind, alone.manager, alone.isolated), (NodeletKind.NODE, "", True))
        process = self.process("/alone")
        client.set_config("/alone", {"words": "/elsewhere"})
        hears("/elsewhere", "moin")
        self.shows("/alone", {"words": "/elsewhere"})
        process.signal(signal.SIGKILL)
        eventually(lambda: self.process("/alone") != process, 10.0, "it is started again")
        hears("/elsewhere", "moin")
        eventually(lambda: self.runs("/alone"), 5.0, "it is shown")
        client.destroy("/alone")
        self.assertEqual(registrations("/alone"), [])

    def test_nodes_end_when_nobody_looks_after_them(self) -> None:
        self.manager.stop()
        self.manager.parameters["orphan_timeout"] = 3.0
        self.manager.start()
        self.manager.client.spawn("copier", "/binary")
        self.manager.client.spawn("talker", "/script", isolated=True)
        processes = [self.process(name) for name in ("/binary", "/script")]
        self.manager.kill()
        time.sleep(0.5)
        self.assertTrue(all(process.alive for process in processes))
        for process in processes:
            self.assertTrue(process.wait(5.0 * BUSY))

    def test_a_node_of_others_supplies_and_demands(self) -> None:
        client = self.manager.client
        command = (*RUN, "topic_tools", "relay", "/b", "/spoken", "__name:=by_hand")
        with graph.Ended(*command):
            self.shows("/by_hand", {"/b": "/b", "/spoken": "/spoken"})
            self.assertEqual(self.manager.nodelet("/by_hand").transformation, "by hand")
            hears("/spoken", "right")
            found = client.acquire_stream(StreamRequest("Spoken(left)"))
            self.assertEqual(found.reused, ("/by_hand",))
            self.assertEqual(found.topic, "/spoken")
            hears("/spoken", "left")
            self.manager.kill()
            self.manager.start()
            (stream,) = client.list_streams()
            self.assertEqual((stream.state, stream.nodelets), (ClaimState.ACTIVE, ("/by_hand",)))
            self.assertNotIn("is gone", stream.detail)
            with self.assertRaisesRegex(Refused, "process of its own"):
                client.destroy("/by_hand")
        eventually(
            lambda: client.list_streams()[0].state is ClaimState.PENDING,
            5.0,
            "the claim waits",
            client.list_streams,
        )
        self.assertIsNone(self.manager.nodelet("/by_hand"))

    def test_a_specification_to_begin_with(self) -> None:
        words = ("topic_tools", "relay", "/a", "/probed", "_lazy:=false")
        code, printed = finished([*PROBE, "--settle", "1", *words])
        self.assertEqual(code, 0, printed)
        self.assertEqual(
            parse(printed).transformations,
            (
                Transformation(
                    "relay",
                    "topic_tools/relay /a /probed",
                    "node",
                    parameters=(Parameter("lazy", "bool", "false"),),
                    ports=(
                        Port("/a", "in"),  # of any type
                        Port("/probed", "out", "std_msgs/String"),
                    ),
                ),
            ),
        )
        self.assertEqual(self.manager.client.add_transformation(printed).labels, ("relay",))
        eventually(  # a manager listens to it for a moment longer
            lambda: not registrations("/dyknow_probe") + parameters("/dyknow_probe"),
            5.0,
            "nothing of it is left",
            lambda: registrations("/dyknow_probe") + parameters("/dyknow_probe"),
        )
        code, printed = finished([*PROBE, "topic_tools", "throttle"])
        self.assertEqual(code, 1)
        self.assertIn("the node ended by itself; it printed at last:", printed)


if __name__ == "__main__":
    rospy.init_node("nodes_test")
    rostest.rosrun("dyknow", "nodes", "__main__")
