#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Compressed images between ports of Python, and with image_transport's own programs."""

from __future__ import annotations

import unittest

import graph  # first: it makes the test packages known
import rospkg
from graph import Heard, Manager, call, connect, nodes_on, port_statistics, topics_of_ports
from manager_suite import ManagerCase, library, specification
from processes import TellingCase, becomes, eventually, run
from rospy import ServiceException
from sensor_msgs.msg import CompressedImage
from test_dyknow_command import Done

PNG = {"image_transport": "compressed", "compressed/format": "png"}


def has_compressed():
    try:
        rospkg.RosPack().get_path("compressed_image_transport")
    except rospkg.ResourceNotFound:
        return False
    return True


class BetweenProcessesTest(TellingCase):
    def setUp(self):
        self.source, self.sink = (self.enter(Manager(name)) for name in ("/source", "/sink"))

    def paints(self, name="/painter", topic="/a", **parameters):
        self.source.load("Painter", name, {"/out": topic}, **{**PNG, **parameters})

    def views(self, name="/viewer", topic="/a", manager=None, **parameters):
        (manager or self.sink).load("Viewer", name, {"/in": topic}, **(parameters or PNG))

    def is_seen(self, wanted, name="/viewer"):
        becomes(lambda: call(name, "seen"), list(wanted))

    def linked(self, topic):
        eventually(lambda: graph.is_linked(topic), 10.0, f"{topic} is connected")

    def test_both_ends_and_nothing_is_compressed_for_nobody(self):
        self.paints()
        call("/painter", "paint", 1)
        self.assertEqual(port_statistics("/painter", "out/compressed").messages, 0)
        self.views()
        self.views("/raw", image_transport="raw")
        self.linked("/a/compressed")
        self.linked("/a")
        self.assertEqual(nodes_on("/a/compressed"), ({"/source"}, {"/sink"}))
        heard = self.enter(Heard("/a/compressed", CompressedImage))
        call("/painter", "paint", 3)
        for name in ("/viewer", "/raw"):
            self.is_seen([1, 2, 3], name)
        self.assertEqual({each.format for each in heard}, {"mono16; png compressed "})
        self.assertEqual(port_statistics("/painter", "out/compressed").messages, 3)
        self.assertEqual(port_statistics("/viewer", "in/compressed").messages, 3)
        self.assertEqual(port_statistics("/viewer", "in").topic, "/a")

    def test_moves_lose_and_double_nothing(self):
        self.paints()
        self.paints("/other", "/b", first=10_000)
        self.views()
        for name in ("/painter", "/other"):
            call(name, "paint_often", 100.0)
        for number in range(20):
            enough = len(call("/viewer", "seen")) + 5
            eventually(lambda n=enough: len(call("/viewer", "seen")) >= n, 10.0, "images come")
            connect("/viewer", **{"in": ("/b", "/a")[number % 2]})
        story = call("/viewer", "seen")
        topic, last = "/a", None
        for each in story:
            if isinstance(each, str):
                topic, last = each, None
            else:
                self.assertEqual(each >= 10_000, topic == "/b", story)
                self.assertIn(each, (last + 1,) if last is not None else (each,), story)
                last = each
        self.assertEqual(len([each for each in story if isinstance(each, str)]), 20)

    def test_an_out_port_takes_its_subscribers_along(self):
        self.paints()
        self.views(manager=self.source)
        connect("/painter", out="/b")
        connect("/viewer", **{"in": "/b"})
        self.assertEqual(
            topics_of_ports("/painter"), {"out": "/b", "out/compressed": "/b/compressed"}
        )
        call("/painter", "paint", 2)
        self.is_seen(["/b", 0, 1])
        connect("/painter", out="")
        self.assertEqual(nodes_on("/b/compressed"), (set(), {"/source"}))

    def test_what_has_no_compressed_form_is_counted_and_sent_plainly(self):
        self.paints()
        self.views()
        self.views("/raw", image_transport="raw")
        self.linked("/a")
        self.linked("/a/compressed")
        call("/painter", "spoil")
        call("/painter", "paint", 1)
        self.is_seen([0])
        self.is_seen([0, 0], "/raw")
        self.assertEqual(graph.get_statistics("/painter").callback_errors, 1)
        self.assertEqual(port_statistics("/painter", "out/compressed").dropped, 1)
        self.source.wait_for("/painter: the callback of 'out/compressed' raised")
        self.source.wait_for("an image of encoding '32FC1': expected mono, rgb")

    def test_an_unknown_transport_is_refused(self):
        with self.assertRaisesRegex(ServiceException, "'theora': expected 'raw' or 'compressed'"):
            self.views(image_transport="theora")
        self.assertEqual(self.sink.list(), [])

    def republish(self, *words):
        self.run_process("rosrun", "image_transport", "republish", *words)

    @unittest.skipUnless(has_compressed(), "compressed_image_transport is not installed")
    def test_image_transports_own_program_understands_ours_and_we_it(self):
        self.paints()
        self.republish("compressed", "raw", "in:=/a", "out:=/decoded", "__name:=decoder")
        self.views(topic="/decoded", image_transport="raw")
        self.parameter("/encoded/compressed/format", "png")
        self.republish("raw", "compressed", "in:=/a", "out:=/encoded", "__name:=encoder")
        self.views("/other_viewer", "/encoded")
        for topic in ("/a", "/a/compressed", "/decoded", "/encoded/compressed"):
            self.linked(topic)
        for wanted in ([0], [0, 1]):  # its queues have one image
            call("/painter", "paint", 1)
            self.is_seen(wanted)
            self.is_seen(wanted, "/other_viewer")

    def test_image_transports_own_program_takes_and_gives_plain_images(self):
        self.paints()
        self.republish("raw", "raw", "in:=/a", "out:=/again")
        self.views(topic="/again", image_transport="raw")
        self.linked("/a")
        self.linked("/again")
        call("/painter", "paint", 1)
        self.is_seen([0])


class ManagerTest(ManagerCase):
    def test_commands_show_it_and_it_outlives_its_process(self):
        manager = self.running()
        manager.client.add_transformation(
            library(
                specification("painter", "dyknow_test/Painter", "out>", **PNG),
                specification("viewer", "dyknow_test/Viewer", ">in"),
            )
        )
        for words in (
            ("spawn", "painter", "p"),
            ("spawn", "viewer", "v", "--param", "in/image_transport=compressed"),
            ("connect", "p:out", "v:in"),
        ):
            self.assertEqual(Done(*words).code, 0)
        topics = {"in": "/p/out", "in/compressed": "/p/out/compressed"}
        manager.shows("/v", **topics)
        info = Done("info", "v", "p").out
        self.assertIn(" * in/compressed [sensor_msgs/CompressedImage]\n", info)
        self.assertIn("    topic: /p/out/compressed\n    from: /p:out/compressed\n", info)
        call("/p", "paint", 2)
        becomes(lambda: call("/v", "seen")[-2:], [0, 1])
        rows = {tuple(line.split()[:2]): line.split()[4] for line in Done("stats").lines}
        self.assertEqual([rows["/v", "in/compressed"], rows["/p", "out/compressed"]], ["2", "2"])
        manager.kill_child()
        for name, wanted in (("/v", topics), ("/p", {"out/compressed": "/p/out/compressed"})):
            eventually(
                lambda name=name, wanted=wanted: wanted.items() <= topics_of(name).items(),
                10.0,
                f"{name} is back",
            )
        file = str(self.make_folder() / "wiring.xml")
        for words in (("save", file), ("destroy", "p", "v"), ("load", file)):
            self.assertEqual(Done(*words).code, 0)
        manager.shows("/v", **topics)
        for words in (("set", "v", "in/image_transport", "raw"), ("restart", "v")):
            self.assertEqual(Done(*words).code, 0)
        self.assertEqual(topics_of_ports("/v"), {"in": "/p/out"})
        refused = Done("spawn", "viewer", "w", "--param", "image_transport=theora")
        self.assertEqual(refused.code, 1)
        self.assertIn("'theora': expected 'raw' or 'compressed'", refused.err)


def topics_of(name):
    """Topics of the ports of a nodelet; none if it is not there."""
    try:
        return topics_of_ports(name)
    except ServiceException:
        return {}


if __name__ == "__main__":
    run()
