#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Images between processes of one host: through shared memory, and compressed."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import subprocess
import sys
import unittest
from collections import Counter
from pathlib import Path

import graph  # first: it makes the test package known
import rospkg
import rospy
from dyknow_test.pictures import is_whole
from graph import Heard, Manager, call, connect, nodes_on, port_statistics, topics_of_ports
from manager_suite import CHILD, ManagerCase, library, specification
from processes import DYKNOW, HELD_UP, Done, TellingCase, becomes, eventually, finished, run
from rospy import ServiceException
from sensor_msgs.msg import CompressedImage, Image

MB = 1 << 20
#: Bytes of one image that goes through shared memory, and of one that does not.
LARGE, SMALL = MB, 1000
#: Runs a command as in a container that shares the network of its host.
CONTAINER = (
    *("unshare", "--mount", "--ipc", "--uts", "--pid", "--fork", "--kill-child", "--mount-proc"),
    *("sh", "-c", 'mount -t tmpfs none /dev/shm && mount -t tmpfs none /run && exec "$@"', "sh"),
)
#: Processes that receive the same images.
RECEIVERS = int(os.environ.get("DYKNOW_TEST_RECEIVERS", "4"))
PNG = {"image_transport": "compressed", "compressed/format": "png"}


def transports(node, topic):
    """The transports of a node's connections to the subscribers of a topic."""
    return sorted(each[3] for each in graph.bus_info(node) if each[2:5:2] == ["o", topic])


def files(pid):
    """The shared memories that a process has open, each with its bytes."""
    found = {}
    for each in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed just now
            if "memfd:dyknow" in os.readlink(each):
                status = each.stat()
                found[status.st_ino] = status.st_blocks * 512
    return found


class PairCase(TellingCase):
    """Tests in two nodelet managers, those of the module, in which each leaves nothing."""

    source: Manager
    sink: Manager

    def setUp(self):
        if "source" not in vars(PairCase):
            for name in ("source", "sink"):
                manager = Manager(f"/{name}")
                unittest.addModuleCleanup(manager.__exit__)
                setattr(PairCase, name, manager)

    def tearDown(self):
        for manager in (self.source, self.sink):
            manager.unload_all()
            manager.forget_output()


class SharedMemoryCase(PairCase):
    """A talker in one process, and listeners in other processes."""

    def talks(self, **parameters):
        self.source.load("PictureTalker", "/talker", {"/out": "/a"}, **parameters)

    def listens(self, name="/listener", topic="/a", manager=None):
        (manager or self.sink).load("PictureListener", name, {"/in": topic, "/out": f"{name}/out"})

    def is_linked(self, *kinds, topic="/a", node="/source"):
        becomes(lambda: transports(node, topic), sorted(kinds))
        eventually(lambda: graph.is_linked(topic, 1), 10.0, f"{topic} is connected")

    def received(self, numbers, name="/listener"):
        becomes(lambda: call(name, "received"), list(numbers))


class TransportTest(SharedMemoryCase):
    def exchanges(self, third, kind):
        """A third process sends to the sink, and receives from the source, by one transport."""
        third.load("PictureTalker", "/other", {"/out": "/b"})
        self.listens(topic="/b")
        self.talks()
        self.listens("/inside", "/a", third)
        self.is_linked(kind, topic="/b", node=third.name)
        self.is_linked(kind)
        call("/other", "publish", 3, LARGE)
        call("/talker", "publish", 3, LARGE)
        self.received(range(3))
        self.received(range(3), "/inside")

    def test_each_peer_has_the_transport_that_it_knows(self):
        self.talks(queue_size=1000)
        self.listens()
        heard = self.enter(Heard("/a", Image, lambda image: (image.height, is_whole(image))))
        eventually(lambda: graph.is_linked("/a", 2), 10.0, "both are connected")
        counter = self.run_process("rostopic", "hz", "/a")
        call("/talker", "publish", 1, LARGE)
        self.is_linked("SHMROS", "TCPROS", "TCPROS")
        call("/talker", "start", 50.0, LARGE, SMALL, 3 * LARGE)
        counter.wait_for("average rate: ")
        eventually(lambda: len(heard) > 25, 20.0, "they come")
        self.assertIn("SHMROS", finished(["rosnode", "info", "/source"])[1])
        self.assertIn("SHMROS", finished(["rosnode", "info", "/sink"])[1])
        count = call("/talker", "stop")
        self.received(range(count))
        becomes(heard.copy, [(number, True) for number in range(count)])

    def test_a_received_image_is_passed_on_to_anybody(self):
        self.talks()
        self.listens()
        third = self.enter(Manager("/third"))
        self.listens("/second", "/listener/out", third)
        heard = self.enter(Heard("/listener/out", Image, lambda image: image.height))
        self.is_linked("SHMROS")
        self.is_linked("SHMROS", "TCPROS", topic="/listener/out", node="/sink")
        call("/talker", "publish", 5, LARGE)
        self.received(range(5), "/second")
        becomes(heard.copy, list(range(5)))

    def test_switched_off_there_is_none(self):
        plain = self.enter(Manager("/plain", "_shared_memory:=false"))
        self.exchanges(plain, "TCPROS")

    def test_scripts_in_processes_of_their_own_share_memory(self):
        self.talks()
        self.run_process(
            *(*DYKNOW, "run", "dyknow_test", "copier.py"), *("original:=/a", "copied:=/c")
        )
        eventually(lambda: graph.is_linked("/a"), 20.0, "it is connected")
        self.is_linked("SHMROS")
        self.listens(topic="/c")
        self.is_linked("SHMROS", topic="/c", node="/copier")
        call("/talker", "publish", 5, LARGE)
        self.received(range(5))

    def test_a_container_with_the_network_of_its_host_shares_memory(self):
        if subprocess.run([*CONTAINER, "true"], check=False).returncode:
            self.skipTest("namespaces cannot be made here")
        boxed = self.enter(Manager("/boxed", command=[*CONTAINER, *graph.NODELET, "manager"]))
        self.exchanges(boxed, "SHMROS")

    def test_where_the_system_gives_no_memory_messages_come_all_the_same(self):
        code = (
            "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20)); "
            "from dyknow.cli.nodelet import main; sys.exit(main(sys.argv))"
        )
        command = [sys.executable, "-c", code, "manager"]
        limited = self.enter(Manager("/limited", command=command))
        limited.load("PictureTalker", "/other", {"/out": "/b"})
        self.listens(topic="/b")
        self.is_linked("TCPROS", topic="/b", node="/limited")
        call("/other", "publish", 3, LARGE)
        self.received(range(3))


class SwitchTest(SharedMemoryCase):
    def heard_on(self, *listeners):
        return sorted(number for each in listeners for number in call(each, "received"))

    def flows(self, listener):
        before = len(call(listener, "received"))
        eventually(lambda: len(call(listener, "received")) > before + 5, 10.0, "images come")

    def test_a_publisher_moves_between_topics(self):
        self.talks(queue_size=1000)
        names = [f"/on_{number}" for number in range(3)]
        for name in names:
            self.listens(name, name.replace("on", "topic"))
        connect("/talker", out="/topic_0")
        self.is_linked("SHMROS", topic="/topic_0")
        call("/talker", "start", 50.0, LARGE, SMALL)
        for name in (*names, *reversed(names)):
            connect("/talker", out=name.replace("on", "topic"))
            self.flows(name)
        count = call("/talker", "stop")
        becomes(lambda: self.heard_on(*names), list(range(count)))
        for name in names:
            received = call(name, "received")
            self.assertEqual(received, sorted(received))

    def test_a_subscriber_moves_between_topics_with_the_same_images(self):
        self.talks(queue_size=1000)
        fan = [f"/fan_{number}" for number in range(2)]
        for name in fan:
            self.source.load("PictureListener", name, {"/in": "/a", "/out": f"{name}/out"})
        self.listens(topic="/fan_0/out")
        self.is_linked("SHMROS", topic="/fan_0/out")
        call("/talker", "start", 50.0, LARGE, SMALL)
        for number in range(6):
            connect("/listener", **{"in": f"/fan_{(number + 1) % 2}/out"})
            self.flows("/listener")
        count = call("/talker", "stop")
        becomes(lambda: sorted(set(call("/listener", "received"))), list(range(count)))
        # At a move an image may come from both topics, as documented.
        self.assertLessEqual(max(Counter(call("/listener", "received")).values()), 2)


class FaultTest(SharedMemoryCase):
    def test_a_killed_subscriber_is_followed_by_another_one(self):
        self.talks()
        call("/talker", "start", 50.0, LARGE)
        for number in range(2):
            third = Manager(f"/victim_{number}")
            with third:
                self.listens(f"/heard_{number}", "/a", third)
                eventually(
                    lambda n=number: len(call(f"/heard_{n}", "received")) > 5, 10.0, "they come"
                )
                third.stop(signal.SIGKILL)
            becomes(lambda: transports("/source", "/a"), [])
        self.listens()
        eventually(lambda: len(call("/listener", "received")) > 20, 10.0, "they come")
        self.assertLess(sum(files(self.source.pid).values()), 70 * MB)

    def test_a_killed_publisher_leaves_nothing(self):
        self.listens()
        opened = set(files(self.sink.pid))
        for number in range(2):
            with Manager(f"/victim_{number}") as victim:
                victim.load("PictureTalker", f"/t_{number}", {"/out": "/a"})
                self.is_linked("SHMROS", node=f"/victim_{number}")
                call(f"/t_{number}", "start", 50.0, LARGE)
                before = len(call("/listener", "received"))
                eventually(
                    lambda b=before: len(call("/listener", "received")) > b + 5, 10.0, "they come"
                )
                victim.stop(signal.SIGKILL)
            becomes(lambda: set(files(self.sink.pid)), opened)

    def test_a_stopped_subscriber_holds_up_nobody_and_takes_no_memory(self):
        self.talks(queue_size=3)
        self.listens()
        third = self.enter(Manager("/third"))
        self.listens("/slow", "/a", third)
        self.is_linked("SHMROS", "SHMROS")
        call("/talker", "publish", 1, LARGE)
        self.received([0], "/slow")
        third.stop(signal.SIGSTOP)
        try:
            self.assertLess(call("/talker", "publish", 50, LARGE), HELD_UP)
            eventually(lambda: call("/listener", "received")[-1] == 50, 10.0, "the last comes")
            # One image announced to the stopped listener, its queue, and those of the other one.
            self.assertLess(sum(files(self.source.pid).values()), 16 * MB)
        finally:
            third.stop(signal.SIGCONT)
        eventually(lambda: call("/slow", "received")[-1] == 50, 10.0, "the last comes")
        received = call("/slow", "received")
        self.assertEqual(received, sorted(set(received)))
        self.assertEqual(received[-3:], [48, 49, 50])

    def test_many_receivers_share_one_copy(self):
        self.talks(queue_size=2)
        names = [f"/l{number}" for number in range(RECEIVERS)]
        managers = [self.enter(Manager(f"/m{name[1:]}", wait=False)) for name in names]
        for name, each in zip(names, managers):
            each.wait_until_up()
            self.listens(name, "/a", each)
        self.is_linked(*["SHMROS"] * RECEIVERS)
        numbers = itertools.count(1)

        def growth():
            """Bytes that one more image takes, once all have received it."""
            before = sum(files(self.source.pid).values())
            call("/talker", "publish", 1, 8 * LARGE)
            number = next(numbers)
            for name in names:
                self.received(range(number), name)
            return sum(files(self.source.pid).values()) - before

        for _ in range(5):
            self.assertLess(growth(), 10 * LARGE)
        # Receivers say a little later that they have copied it; then its memory is used again.
        eventually(lambda: growth() <= 0, 20.0, "the memory of an image is used again")


def has_compressed():
    try:
        rospkg.RosPack().get_path("compressed_image_transport")
    except rospkg.ResourceNotFound:
        return False
    return True


class CompressedTest(PairCase):
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
            call(name, "paint_often", 50.0)
        for number in range(10):
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
        self.assertEqual(len([each for each in story if isinstance(each, str)]), 10)

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
    def test_a_manager_decides_for_its_processes(self):
        manager = self.started(shared_memory=False)
        self.assertIs(rospy.get_param(f"{CHILD}/shared_memory"), False)
        manager.stop()
        self.assertFalse(rospy.has_param(f"{CHILD}/shared_memory"))

    def test_commands_show_transports_and_an_image_outlives_its_process(self):
        manager = self.started()
        self.assertIs(rospy.get_param(f"{CHILD}/shared_memory"), True)
        manager.client.spawn("relay", "/shown", {"out": "/shown_out"})
        with Heard("/shown_out"):
            self.assertRegex(Done("stats", "shown").out, r"/shown_out +TCPROS\n")
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
