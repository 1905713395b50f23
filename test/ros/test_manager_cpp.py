#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""C++ nodelets of image_proc under the DyKnow manager, in one graph with Python ones."""

from __future__ import annotations

import math
import os
import subprocess
from pathlib import Path

import cpp_suite
import rospkg
import rospy
from cpp_suite import Camera
from dyknow_msgs.msg import Counts
from dyknow_msgs.srv import GetStatistics
from graph import Heard
from manager_suite import CPP_CHILD, MANAGER, ManagerCase, registrations, specification
from processes import BUSY, eventually, run
from sensor_msgs.msg import Image

from dyknow.cli.rewirable import find_library
from dyknow.errors import Refused
from dyknow.model.graph import NodeletKind, State
from dyknow.model.streams import StreamRequest

EXAMPLES = Path(rospkg.RosPack().get_path("dyknow")) / "examples/transformations"
RELAY = specification("images", "dyknow/Relay", ">in out>", datatype="sensor_msgs/Image")


def size_on(topic: str, timeout: float = 10.0 * BUSY) -> tuple[int, int]:
    image = rospy.wait_for_message(topic, Image, timeout)
    return image.width, image.height


def sent(counts: Counts) -> list[tuple[str, int]]:
    return [(each.nodelet, port.messages) for each in counts.nodelets for port in each.ports]


class CppCase(ManagerCase):
    def film(self, namespace: str, width: int) -> None:
        self.addCleanup(Camera(namespace, width).close)


class CppTest(CppCase):
    def setUp(self):
        self.manager = self.started()
        self.client = self.manager.client
        self.client.add_transformation((EXAMPLES / "image_proc.xml").read_text())
        self.client.add_transformation(RELAY)
        for namespace in ("/cam", "/cam2", "/left"):
            self.film(namespace, 8)
        self.film("/right", 16)

    def test_a_chain_of_both_kinds(self):
        self.client.spawn("images", "/relay", {"in": "/cam/image_raw", "out": "/copy"})
        self.client.spawn("resize", "/robot/resize", {"image": "/copy", "~image": "/small"})
        self.assertEqual(size_on("/small"), (4, 3))
        found = self.manager.nodelet("/robot/resize")
        self.assertEqual((found.kind, found.is_fixed), (NodeletKind.CPP, False))
        self.assertEqual((found.manager, found.state), (CPP_CHILD, State.RUNNING))
        self.assert_declared({"image": "/copy", "~image": "/small"})
        self.assertEqual(rospy.get_param("/robot/resize/scale_width"), 0.5)
        told = self.enter(Heard(f"{MANAGER}/counts", Counts, sent))
        told.has(lambda sent: {"/relay", "/robot/resize"} <= {name for name, n in sent if n > 0})

        before = self.client.get_statistics("/robot/resize")
        self.client.set_config("/robot/resize", {"image": "/cam2/image_raw"})
        self.assert_declared({"image": "/cam2/image_raw", "~image": "/small"})
        with self.assertRaisesRegex(Refused, "sideways"):
            self.client.set_config("/robot/resize", {"sideways": "/x"})
        after = self.client.get_statistics("/robot/resize")
        self.assertGreater(after.uptime, before.uptime, "it was not loaded again")
        self.assertEqual(after.reconfigurations, before.reconfigurations + 1)
        counts = {port.port: port.messages for port in after.ports}
        self.assertGreater(counts["~image"], 0)
        self.client.set_config("/robot/resize", {"camera_info": "/cam2/camera_info"})
        self.assert_declared(
            {"image": "/cam2/image_raw", "~image": "/small", "camera_info": "/cam2/camera_info"}
        )

        self.client.destroy("/robot/resize")
        eventually(lambda: registrations("/robot") == [], 2.0, "nothing is left")
        eventually(lambda: registrations("/small") == [], 2.0, "nothing is left")

    def assert_declared(self, topics: dict[str, str]) -> None:
        """The model shows the declared ports, lazy ones too, and the proxy those that exist."""
        declared = ("image", "camera_info", "~image", "~camera_info")
        wanted = {**dict.fromkeys(declared, ""), **topics}

        def shown() -> dict[str, str]:
            found = self.manager.topics("/robot/resize")
            return {port: found[port] for port in declared}

        eventually(lambda: shown() == wanted, 2.0, "the model shows it", shown)
        ports = {port.name: port.topic for port in self.client.get_config("/robot/resize")}
        self.assertEqual({**wanted, **{p: ports[p] for p in declared if p in ports}}, wanted)

    def test_the_example_with_both_kinds(self):
        self.client.add_transformation((EXAMPLES / "thumbnails.xml").read_text())
        claim = self.client.acquire_stream(StreamRequest("Thumbnail(room)"))
        self.assertEqual(size_on(claim.topic)[0], 2)
        kinds = {each.kind for each in self.client.get_graph().nodelets}
        self.assertEqual(kinds, {NodeletKind.PYTHON, NodeletKind.CPP})
        quarter = next(name for name in claim.spawned if "quarter" in name)
        before = self.client.get_statistics(quarter)
        self.client.remove_transformation("left camera")
        eventually(lambda: size_on(claim.topic)[0] == 4, 10.0, "it sees the right camera")
        after = self.client.get_statistics(quarter)
        self.assertGreater(after.reconfigurations, before.reconfigurations)
        self.assertGreater(after.uptime, before.uptime, "it was not loaded again")
        self.client.release_stream(claim.claim_id)

    def test_kill_9_of_the_cpp_nodelet_manager_and_of_the_manager(self):
        self.client.spawn("resize", "/resize", {"image": "/cam/image_raw", "~image": "/small"})
        self.assertEqual(size_on("/small"), (4, 3))
        self.manager.kill_child(CPP_CHILD)
        self.manager.becomes("/resize", State.RUNNING)
        self.assertEqual(size_on("/small"), (4, 3))
        process = self.manager.child(CPP_CHILD)
        self.manager.kill()
        self.assertEqual(size_on("/small"), (4, 3))
        self.manager.start()
        self.assertEqual(self.manager.child(CPP_CHILD), process)
        self.client.set_config("/resize", {"image": "/right/image_raw"})
        eventually(lambda: size_on("/small")[0] == 8, 10.0, "it sees the other camera")
        self.manager.stop()
        self.assertFalse(process.alive)
        self.assertEqual(registrations("/resize"), [])


class StockTest(CppCase):
    """Where the library cannot stand in front of libroscpp, topics are fixed."""

    def test_a_failing_self_check(self):
        linked = subprocess.run(["ldd", str(find_library())], stdout=subprocess.PIPE, text=True)
        roscpp = next(line.split()[2] for line in linked.stdout.splitlines() if "roscpp." in line)
        os.environ["LD_PRELOAD"] = roscpp  # its functions are found first then
        try:
            manager = self.started(own=True)
        finally:
            del os.environ["LD_PRELOAD"]
        client = manager.client
        client.add_transformation((EXAMPLES / "image_proc.xml").read_text())
        self.film("/cam", 8)
        client.spawn("resize", "/resize", {"image": "/cam/image_raw", "~image": "/small"})
        self.assertEqual(size_on("/small"), (4, 3))
        self.assertIn("cannot be connected while they run", manager.output)
        why = f"of {roscpp} is found before that of"  # the nodelet manager says it itself
        eventually(lambda: why in manager.output, 5.0, "the cause is told")
        found = manager.nodelet("/resize")
        self.assertEqual((found.kind, found.is_fixed), (NodeletKind.CPP, True))
        for connect in (
            lambda: client.set_config("/resize", {"~image": "/smaller"}),
            lambda: client.connect([("resize", {"~image": "/smaller"})]),
        ):
            with self.assertRaisesRegex(Refused, "the topics of '/resize' are fixed.*rewirable"):
                connect()
        shown = {port.name: port.topic for port in client.get_config("/resize")}
        self.assertEqual(shown["~image"], "/small")
        self.assertEqual(size_on("/small"), (4, 3))
        statistics = rospy.ServiceProxy("/resize/get_statistics", GetStatistics)()
        self.assertEqual(statistics.reconfigurations, 0)
        self.assertEqual([math.isnan(port.rate) for port in statistics.ports], [True] * 4)
        traffic = client.get_statistics("/resize").ports
        self.assertEqual([port.messages for port in traffic], [None] * 4)


class ExternalTest(ManagerCase):
    """External C++ nodelet managers."""

    def test_ours_and_a_stock_one(self):
        for name, command in (("/ours", cpp_suite.OURS), ("/stock", cpp_suite.STOCK)):
            process = cpp_suite.CppManager(name, *command)
            self.addCleanup(process.__exit__)
            process.load("image_proc/resize", f"{name}_resize", {"image": "/cam/image_raw"})
        manager = self.started(nodelet_managers=["/ours", "/stock"])
        for name in ("/ours_resize", "/stock_resize"):
            eventually(lambda name=name: manager.nodelet(name), 10.0, f"{name} is seen")
        self.assertIs(manager.nodelet("/ours_resize").kind, NodeletKind.CPP)
        eventually(lambda: "~image" in manager.topics("/ours_resize"), 10.0, "its ports are seen")
        self.assertEqual(manager.topics("/stock_resize"), {})
        self.assertTrue(manager.nodelet("/stock_resize").is_fixed)
        manager.client.set_config("/ours_resize", {"~image": "/small"})
        manager.shows("/ours_resize", **{"~image": "/small"})
        manager.client.add_transformation((EXAMPLES / "image_proc.xml").read_text())
        for name in ("/ours", "/stock"):
            manager.client.spawn("resize", f"{name}_spawned", manager=name)
            found = manager.nodelet(f"{name}_spawned")
            self.assertEqual(found.is_fixed, name == "/stock")
            manager.client.destroy(f"{name}_spawned")


if __name__ == "__main__":
    run()
