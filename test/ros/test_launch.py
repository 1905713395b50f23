#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`dyknow launch` beside roslaunch: the same graph, the same end, and nodes that are re-wired."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Sequence

import graph
import rosgraph
import rospy
from graph import comes, connect, registered, topics_of_ports
from processes import BUSY, DYKNOW, TellingCase, becomes, eventually, free_port, run
from std_msgs.msg import String

from dyknow.ros.wire.master import Master

FILES = Path(__file__).resolve().parent.parent / "launch"
LAUNCH = (*DYKNOW, "launch")
PLAIN = ("roslaunch",)
#: Additional names of a re-wirable node and, the last one, of a nodelet manager.
OURS = re.compile("^/dyknow/|/(get_config|set_config|get_statistics|changes)$")


class Launched(graph.Ended):
    """A launch with a master of its own, or with that of the tests."""

    def __init__(self, launcher: Sequence[str], file: str, *arguments: str, own: bool) -> None:
        port = free_port()
        self.uri = f"http://localhost:{port}" if own else rosgraph.get_master_uri()
        more = ("-p", port) if own else ()
        super().__init__(
            *("env", f"ROS_MASTER_URI={self.uri}"),
            *(*launcher, "--skip-log-check", *more, str(FILES / file), *arguments),
        )

    def graph(self) -> dict[str, dict[str, set[str]]]:
        """Topics and services of the robot's nodes, without those that make them re-wirable."""
        kinds = ("publishers", "subscribers", "services")
        found: dict[str, dict[str, set[str]]] = {}
        for kind, entries in zip(kinds, self._master.getSystemState()):
            for name, nodes in entries:
                for node in nodes:
                    if node.startswith("/one/") and not OURS.search(name):
                        found.setdefault(node, {}).setdefault(kind, set()).add(name)
        return found

    def is_complete(self) -> bool:
        """Whether the last of a chain of nodelets and nodes hears the first one."""
        try:
            types = dict(self._master.getTopicTypes())
        except (OSError, rosgraph.MasterException):
            return False
        return types.get("/one/camera/seen") == "sensor_msgs/Image" and "/one/again" in types

    def parameters(self) -> dict[str, Any]:
        return dict(self._master.getParam("/one"), name=self._master.getParam("/robot_name"))

    @property
    def _master(self) -> rosgraph.Master:
        return rosgraph.Master("/tests", self.uri)


def rewirable_nodes(*words: str) -> set[str]:
    """Names of the nodes that a dry run says will be re-wirable."""
    done = subprocess.run(
        [*LAUNCH, *words, "--dry-run", "--json"], stdout=subprocess.PIPE, check=True, text=True
    )
    return {each["node"] for each in json.loads(done.stdout)["nodes"] if not each["why"]}


class RobotTest(TellingCase):
    """One robot, launched by us and beside it by roslaunch."""

    ours: Launched
    plain: Launched

    @classmethod
    def setUpClass(cls) -> None:
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        picture = Path(folder.name) / "picture.ppm"
        picture.write_bytes(b"P6\n8 8\n255\n" + bytes(192))
        cls.words = (f"picture:={picture}", "bag:=")
        bags = [f"bag:={Path(folder.name) / name}.bag" for name in ("ours", "plain")]
        cls.ours = Launched(LAUNCH, "robot.launch", cls.words[0], bags[0], own=False)
        cls.addClassCleanup(cls.ours.__exit__)
        cls.plain = Launched(PLAIN, "robot.launch", cls.words[0], bags[1], own=True)
        cls.addClassCleanup(cls.plain.__exit__)
        for launch in (cls.ours, cls.plain):
            eventually(
                launch.is_complete, 30.0, "all nodes are up", lambda each=launch: each.output
            )

    def ports(self, node: str) -> dict[str, str]:
        """Topics of the ports of a node, which may only be starting."""
        rospy.wait_for_service(f"{node}/get_config", 20.0 * BUSY)
        return topics_of_ports(node)

    def has_ports(self, node: str, **topics: str) -> None:
        becomes(lambda: self.ports(node), topics)

    def test_the_graph_is_that_of_roslaunch(self):
        eventually(
            lambda: self.ours.graph() == self.plain.graph() and len(self.ours.graph()) == 13,
            10.0,
            "both have the same graph",
            lambda: f"{self.ours.graph()}\n{self.plain.graph()}",
        )
        self.assertEqual(self.ours.parameters(), self.plain.parameters())

    def test_the_start_says_what_is_left_alone(self):
        self.assertRegex(self.ours.output, "re-wirable: 8 of 13 nodes\n")
        for line in (
            r"left alone: /one/recorder \(a bag names the topics that were recorded\)",
            r"left alone: /one/camera/debayer, /one/camera/driver, .*it loads a nodelet",
        ):
            self.assertRegex(self.ours.output, line)

    def test_all_that_are_to_be_rewirable_are(self):
        self.has_ports("/one/repeater", heard="/one/words", said="/one/said")
        topics = {"slow/rarely": "/one/slow/rarely", "again": "/one/again"}
        self.has_ports("/one/in_its_folder", **topics)
        nodes = rewirable_nodes(str(FILES / "robot.launch"), *self.words)
        few = {f"/one/{name}" for name in ("repeater", "in_its_folder", "slow/throttle")}
        self.assertGreaterEqual(nodes, {*few, "/one/slow/chooser"})
        nodes |= {f"/one/camera/{name}" for name in ("rectify_mono", "debayer", "driver")}
        for node in nodes - {"/one/camera/vision"}:
            eventually(lambda node=node: self.ports(node), 10.0, f"{node} has ports")

    def test_nodelets_of_an_included_file_are_rewired(self):
        debayer, manager = "/one/camera/debayer", "/one/camera/vision"
        eventually(lambda: "image_raw" in self.ports(debayer), 10.0, "it is subscribed to")
        topics = self.ports(debayer)
        self.assertEqual(topics["image_raw"], "/one/camera/image_raw")
        connect(debayer, image_color="/moved/color")
        self.assertIn("publishers /moved/color", registered(manager))
        connect(debayer, **topics)

    def test_a_script_is_rewired(self):
        port = "/one/words"  # the script makes the name global itself
        eventually(lambda: port in self.ports("/one/talker"), 10.0, "it talks")
        connect("/one/talker", **{port: "/moved/words"})
        comes("/moved/words", String)
        connect("/one/talker", **{port: port})

    def test_a_node_that_is_started_again_is_rewirable_again(self):
        comes("/one/said", String)
        for number in range(2):
            eventually(lambda: "said" in self.ports("/one/repeater"), 10.0, "it has the port")
            connect("/one/repeater", said="/moved/said")
            comes("/moved/said", String)
            if number == 0:
                subprocess.run(["rosnode", "kill", "/one/repeater"], check=True)
                comes("/one/said", String)  # it is back where the file puts it
        connect("/one/repeater", said="/one/said")

    def test_a_node_runs_in_its_folder(self):
        node, master = "/one/in_its_folder", Master("/tests")
        pid = master.pid(node, master.node(node), 2.0 * BUSY)
        self.assertEqual(os.readlink(f"/proc/{pid}/cwd"), "/usr/lib/topic_tools")


class EndTest(TellingCase):
    """How a launch ends; each starts a master of its own."""

    def launched(self, launcher: Sequence[str], *arguments: str) -> Launched:
        return self.enter(Launched(launcher, "ends.launch", *arguments, own=True))

    def ended(self, launch: Launched) -> int:
        """Its exit code; it has ended all that it started."""
        code = launch.exit_code(20.0)
        self.assertIn("[master] killing on exit", launch.output)
        self.assertIn("[stays-2] killing on exit", launch.output)
        return code

    def test_a_required_node_ends_it_as_it_ends_roslaunch(self):
        launches = [self.launched(each, "code:=3") for each in (LAUNCH, PLAIN)]
        for launch in launches:
            launch.wait_for("REQUIRED process [ends-3] has died!")
        self.assertEqual(*map(self.ended, launches))

    def test_ctrl_c_ends_it(self):
        launch = self.launched(LAUNCH, "required:=false")
        launch.wait_for("[ends-3] process has finished cleanly")
        launch.stop(signal.SIGINT)
        self.assertEqual(self.ended(launch), 0)


if __name__ == "__main__":
    run()
