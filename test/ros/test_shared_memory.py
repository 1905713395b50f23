#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Images between processes of one host, through shared memory: nothing lost, nothing mixed up."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import graph  # first: it makes the test package known
import rospy
from dyknow_test.pictures import is_whole
from graph import Heard, Manager, call, connect
from manager_suite import CHILD, ManagerCase
from processes import DYKNOW, HELD_UP, TellingCase, becomes, eventually, finished, run
from sensor_msgs.msg import Image

MB = 1 << 20
#: Bytes of one image that goes through shared memory, and of one that does not.
LARGE, SMALL = MB, 1000
#: What a container has of its own if it shares the network of its host.
CONTAINER = (
    *("unshare", "--mount", "--ipc", "--uts", "--pid", "--fork", "--kill-child", "--mount-proc"),
    *("sh", "-c", 'mount -t tmpfs none /dev/shm && mount -t tmpfs none /run && exec "$@"', "sh"),
)
#: Processes that receive the same images.
RECEIVERS = int(os.environ.get("DYKNOW_TEST_RECEIVERS", "4"))


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


class SharedMemoryCase(TellingCase):
    """A talker in one process and listeners in others."""

    def setUp(self):
        super().setUp()
        self.source = self.enter(Manager("/source"))
        self.sink = self.enter(Manager("/sink"))

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
        self.talks()
        self.listens()
        heard = self.enter(Heard("/a", Image, lambda image: (image.height, is_whole(image))))
        counter = self.run_process("rostopic", "hz", "/a")
        call("/talker", "publish", 1, LARGE)
        self.is_linked("SHMROS", "TCPROS", "TCPROS")
        call("/talker", "start", 50.0, LARGE, SMALL, 3 * LARGE)
        counter.wait_for("average rate: ")
        eventually(lambda: len(heard) > 50, 20.0, "they come")
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
        names = [f"/on_{number}" for number in range(5)]
        for name in names:
            self.listens(name, name.replace("on", "topic"))
        connect("/talker", out="/topic_0")
        self.is_linked("SHMROS", topic="/topic_0")
        call("/talker", "start", 100.0, LARGE, SMALL)
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
        call("/talker", "start", 100.0, LARGE, SMALL)
        for number in range(10):
            connect("/listener", **{"in": f"/fan_{(number + 1) % 2}/out"})
            self.flows("/listener")
        count = call("/talker", "stop")
        becomes(lambda: sorted(set(call("/listener", "received"))), list(range(count)))
        # At a move an image may come from both topics, as documented.
        self.assertLessEqual(len(call("/listener", "received")), count + 10)


class FaultTest(SharedMemoryCase):
    def test_a_killed_subscriber_is_followed_by_another_one(self):
        self.talks()
        call("/talker", "start", 100.0, LARGE)
        for number in range(3):
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
        for number in range(3):
            with Manager(f"/victim_{number}") as victim:
                victim.load("PictureTalker", f"/t_{number}", {"/out": "/a"})
                self.is_linked("SHMROS", node=f"/victim_{number}")
                call(f"/t_{number}", "start", 100.0, LARGE)
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
            # One that the stopped one has been told of, its queue, and those of the other one.
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
        for number in range(5):
            call("/talker", "publish", 1, 8 * LARGE)
            for name in names:
                self.received(range(number + 1), name)
        self.assertLess(sum(files(self.source.pid).values()), 30 * MB)


class ManagerTest(ManagerCase):
    def test_a_manager_decides_for_its_processes(self):
        for wanted in (False, True):
            manager = self.started(shared_memory=wanted)
            self.assertIs(rospy.get_param(f"{CHILD}/shared_memory"), wanted)
            manager.stop()
            self.assertFalse(rospy.has_param(f"{CHILD}/shared_memory"))

    def test_the_command_line_shows_the_transports(self):
        manager = self.started()
        manager.client.spawn("relay", "/shown", {"out": "/shown_out"})
        with Heard("/shown_out"):
            code, output = finished([*DYKNOW, "stats", "shown"])
        self.assertEqual(code, 0, output)
        self.assertRegex(output, r"/shown_out +TCPROS\n")


if __name__ == "__main__":
    run()
