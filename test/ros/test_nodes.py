#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Unchanged programs that the manager starts as nodes, restores, adopts and ends."""

from __future__ import annotations

import signal

import rospy
import rostest
from manager_suite import ManagerCase, parameters, registrations
from processes import eventually
from std_msgs.msg import String

from dyknow.errors import Refused
from dyknow.model.graph import NodeletKind, State
from dyknow.model.transformation import Parameter
from dyknow.ros.os_process import ProcessId

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
</transformations>"""


class Talker:
    """Publishes a word on a topic, many times a second, until it is closed."""

    def __init__(self, topic: str, word: str) -> None:
        self._publisher = rospy.Publisher(topic, String, queue_size=10)
        self._timer = rospy.Timer(rospy.Duration(0.02), lambda _: self._publisher.publish(word))

    def close(self) -> None:
        self._timer.shutdown()
        self._publisher.unregister()


def hears(topic: str, word: str, timeout: float = 10.0) -> None:
    """Wait until a word comes on a topic."""
    heard: set[str] = set()
    subscriber = rospy.Subscriber(topic, String, lambda message: heard.add(message.data))
    try:
        eventually(lambda: word in heard, timeout, f"'{word}' comes on {topic}", lambda: heard)
    finally:
        subscriber.unregister()


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
        eventually(lambda: self.manager.topics(name)["words"] == "/b", 2.0, "it is shown")

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


if __name__ == "__main__":
    rospy.init_node("nodes_test")
    rostest.rosrun("dyknow", "nodes", "__main__")
