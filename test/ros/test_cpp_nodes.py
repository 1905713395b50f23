#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodes of roscpp in processes of their own, unchanged: re-wired, shown, guarded."""

from __future__ import annotations

import signal
import tempfile
from pathlib import Path

import graph
import rospy
import rostest
from cpp_suite import RUN
from graph import Talker, hears, set_config
from manager_suite import ManagerCase
from processes import BUSY, eventually
from sensor_msgs.msg import CameraInfo, Image

from dyknow.errors import Refused
from dyknow.model.graph import NodeletKind
from dyknow.ros.nodelets.guard_parameters import guards_key


class NodeTest(ManagerCase):
    """Nodes beside a DyKnow manager, which did not start them."""

    def setUp(self):
        for topic, word in (("/a", "left"), ("/b", "right")):
            talker = Talker(topic, word)
            self.addCleanup(talker.close)
        self.manager = self.started(denied_topics=["/estop"])

    def run_node(self, *command: str) -> graph.Ended:
        process = graph.Ended(*command)
        self.addCleanup(process.__exit__)
        return process

    def shown(self, name: str):
        eventually(lambda: self.manager.nodelet(name), 10.0, f"{name} is in the model")
        return self.manager.nodelet(name)

    def test_a_relay_is_shown_and_rewired(self):
        process = self.run_node(*RUN, "topic_tools", "relay", "/a", "/out", "__name:=copier")
        hears("/out", "left", is_whole=True)
        node = self.shown("/copier")
        self.assertEqual(
            (node.kind, node.manager, node.transformation), (NodeletKind.CPP_NODE, "", "")
        )
        eventually(
            lambda: self.manager.topics("/copier") == {"/a": "/a", "/out": "/out"},
            5.0,
            "its ports are shown",
            lambda: self.manager.topics("/copier"),
        )
        self.manager.client.set_config("/copier", {"/a": "/b"})
        hears("/out", "right", is_whole=True)
        eventually(lambda: self.manager.topics("/copier")["/a"] == "/b", 2.0, "it is shown")
        self.manager.client.set_config("/copier", {"/out": "/elsewhere"})
        hears("/elsewhere", "right", is_whole=True)
        with self.assertRaisesRegex(Refused, "'/estop' is denied"):
            self.manager.client.set_config("/copier", {"/out": "/estop"})
        with self.assertRaisesRegex(Refused, "process of its own; end it with: rosnode kill"):
            self.manager.client.destroy("/copier")
        process.stop()
        self.assertEqual(process.exit_code(5.0), 0)
        eventually(lambda: self.manager.nodelet("/copier") is None, 2.0, "it is shown no more")
        self.assertEqual(graph.registrations("/copier")["publishers"], [])
        self.assertFalse(rospy.has_param(f"/copier/{guards_key('/dyknow_manager')}"))

    def test_a_node_is_shown_while_it_runs_whichever_side_began_first(self):
        words = ("throttle", "messages", "/a", "20", "/slow", "__name:=slow")
        process = self.run_node(*RUN, "topic_tools", *words)
        hears("/slow", "left", is_whole=True)
        self.shown("/slow")
        process.stop(signal.SIGKILL)
        eventually(lambda: self.manager.nodelet("/slow") is None, 3.0, "it is shown no more")
        self.run_node(*RUN, "topic_tools", *words)
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
            self.run_node("roslaunch", str(file))
            hears("/out", "left", is_whole=True)
            self.shown("/robot/mux")
            answer = set_config("/robot/mux", **{"/a": "/b"})
            self.assertTrue(answer.success, answer.message)
            hears("/out", "right", is_whole=True)

    def test_a_standalone_nodelet(self):
        with tempfile.TemporaryDirectory() as folder:
            picture = Path(folder) / "picture.ppm"
            picture.write_bytes(b"P6\n2 2\n255\n" + bytes(12))
            self.run_node(
                *(*RUN, "nodelet", "nodelet", "standalone", "image_publisher/image_publisher"),
                *(f"_filename:={picture}", "__name:=painter"),
            )
            self.shown("/painter")
            port = next(
                port
                for port in self.shown("/painter").ports
                if port.datatype == "sensor_msgs/Image"
            )
            self.assertEqual(rospy.wait_for_message(port.topic, Image, 20.0 * BUSY).width, 2)
            self.manager.client.set_config("/painter", {port.name: "/moved/image"})
            self.assertEqual(rospy.wait_for_message("/moved/image", Image, 10.0 * BUSY).width, 2)
            rospy.wait_for_message("/moved/camera_info", CameraInfo, 10.0 * BUSY)


if __name__ == "__main__":
    rospy.init_node("cpp_nodes_test")
    rostest.rosrun("dyknow", "cpp_nodes", "__main__")
