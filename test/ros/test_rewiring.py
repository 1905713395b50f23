#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ports that are re-wired while messages flow, inside and across processes."""

from __future__ import annotations

import re
import signal
import time

import graph  # first: it makes the test package known
import rospy
import rostest
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import SetConfig
from graph import (
    PEER,
    Ended,
    NodeletManagerCase,
    call,
    get_statistics,
    port_statistics,
    set_config,
)
from processes import HELD_UP, eventually

#: Seconds that a set_config waits for peers outside.
PATIENCE = 0.5


def missing(numbers):
    """The missing numbers between the first and the last."""
    return set(range(min(numbers), max(numbers) + 1)) - set(numbers)


class RewiringTest(NodeletManagerCase):
    def start_peer(self, *arguments):
        peer = Ended(*PEER, *arguments)
        self.addCleanup(peer.__exit__)
        return peer

    def assert_complete(self, numbers, what=""):
        """Check that no number is missing; returns how many are doubled."""
        lost = missing(numbers)
        self.assertFalse(lost, f"{len(lost)} lost {what}: {sorted(lost)[:20]}")
        return len(numbers) - len(set(numbers))


class AcrossProcessesTest(RewiringTest):
    def test_an_in_port_between_outside_publishers_loses_nothing(self):
        """Except for switches to a publisher that does not connect in time."""
        # The same number on both topics: a port always connected to one of them gets all.
        self.start_peer("talk", "1000", "/a", "/b")
        self.manager.load("Listener", "/n", {"/in": "/a"})
        eventually(lambda: call("/n", "count") > 100, 10.0, "messages come")
        switches = []  # how long each took (s), and how many messages were there afterwards
        for number in range(20):
            topic = ("/b", "/a")[number % 2]
            begin = time.monotonic()
            self.assertTrue(set_config("/n", **{"in": topic}).success)
            duration = time.monotonic() - begin
            self.assertLess(duration, HELD_UP)
            count = call("/n", "count")
            eventually(lambda count=count: call("/n", "count") > count + 20, 5.0, "they flow on")
            switches.append((duration, call("/n", "count")))
            # The old one is gone when the call returns.
            self.assertEqual(graph.nodes_on(("/a", "/b")[number % 2])[1], set())
        received = call("/n", "received")
        lost = set()
        for duration, count in switches:
            lost_here, lost = missing(received[:count]) - lost, missing(received[:count])
            if duration < PATIENCE:
                self.assertFalse(lost_here, f"by a switch of {duration:.3f} s")
        self.assertGreater(sum(duration < PATIENCE for duration, _ in switches), 0)
        # A number may come on both topics, but on neither of them twice.
        of_topic: list[int] = []
        for event in [*call("/n", "story"), []]:
            if isinstance(event, int):
                of_topic.append(event)
                continue
            self.assertEqual(of_topic, sorted(set(of_topic)))
            of_topic.clear()
        self.assertEqual(port_statistics("/n", "in").dropped, 0)

    def test_an_in_port_waits_for_publishers_that_greet_long_before_they_send(self):
        self.start_peer("hesitate", "0.2", "1000", "/a", "/b")
        self.manager.load("Listener", "/n", {"/in": "/a"})
        eventually(lambda: call("/n", "count") > 100, 10.0, "messages come")
        for topic in ("/b", "/a"):
            self.assertTrue(set_config("/n", **{"in": topic}).success)
            count = call("/n", "count")
            eventually(lambda count=count: call("/n", "count") > count + 20, 5.0, "they flow on")
        self.assert_complete(call("/n", "received"))

    def test_an_out_port_between_topics_that_others_listen_to_loses_nothing(self):
        peers = [self.start_peer("listen", "/a", "/b") for _ in range(2)]
        self.manager.load("Talker", "/n", {"/out": "/a"}, queue_size=1000)
        eventually(lambda: len(graph.nodes_on("/b")[1]) == 2, 10.0, "they listen")
        eventually(lambda: call("/n", "connections") == 2, 10.0, "they are connected")
        call("/n", "start", 1000.0)
        switches = 10
        for number in range(switches):
            topic = ("/b", "/a")[number % 2]
            self.assertTrue(set_config("/n", out=topic).success)
            sent = port_statistics("/n", "out").messages
            eventually(
                lambda sent=sent: port_statistics("/n", "out").messages > sent + 50, 5.0, "more"
            )
        last = call("/n", "stop") - 1
        for peer in peers:
            eventually(lambda peer=peer: f" {last}\n" in peer.output, 10.0, "the last one arrives")
            heard = re.findall(r"^(/[ab]) (\d+)$", peer.output, re.M)
            numbers = [int(number) for _, number in heard]
            self.assertEqual(min(numbers), 0)
            self.assertEqual(self.assert_complete(numbers), 0, "nothing comes twice")
            for topic in ("/a", "/b"):  # the listener has a thread for each
                mine = [int(number) for name, number in heard if name == topic]
                self.assertEqual(mine, sorted(mine))

    def test_a_subscriber_that_connects_late_misses_nothing(self):
        peer = self.start_peer("listen", "/a", "/b")
        self.manager.load("Talker", "/n", {"/out": "/a"}, queue_size=1000)
        eventually(lambda: graph.nodes_on("/b")[1], 10.0, "it listens")
        eventually(lambda: call("/n", "connections") == 1, 10.0, "it is connected")
        call("/n", "start", 200.0)
        eventually(lambda: port_statistics("/n", "out").messages > 20, 10.0, "it talks")
        peer.stop(signal.SIGSTOP)
        answer = set_config("/n", out="/b")
        self.assertTrue(answer.success, answer.message)
        sent = port_statistics("/n", "out").messages
        eventually(lambda: port_statistics("/n", "out").messages > sent + 20, 5.0, "it talks on")
        self.assertNotIn("/b ", peer.output)
        peer.stop(signal.SIGCONT)
        eventually(lambda: "/b " in peer.output, 10.0, "it hears the new topic")
        last = call("/n", "stop") - 1
        eventually(lambda: f"/b {last}\n" in peer.output, 10.0, "the last one arrives")
        numbers = [int(number) for number in re.findall(r"^/[ab] (\d+)$", peer.output, re.M)]
        self.assertEqual(min(numbers), 0)
        self.assertEqual(self.assert_complete(numbers), 0, "nothing comes twice")
        # A subscriber that connects to a topic that is gone never connects again, so the old
        # one stays as long as a subscriber may still be connecting to it.
        eventually(lambda: not graph.nodes_on("/a")[0], 15.0, "the old one is gone")

    def test_large_messages_are_sent_before_the_old_topic_goes(self):
        peer = self.start_peer("watch", "/a")
        self.manager.load("ImageTalker", "/n", {"/out": "/a"})
        eventually(lambda: port_connections("/manager", "/a"), 10.0, "connected")
        call("/n", "publish", 30, 4_000_000)
        self.assertTrue(set_config("/n", out="/b").success)
        for number in range(30):
            peer.wait_for(f"/a {number} 4000000\n")
        eventually(lambda: not graph.nodes_on("/a")[0], 5.0, "the old one is gone")

    def test_a_stopped_subscriber_holds_up_set_config_for_half_a_second_at_most(self):
        peer = self.start_peer("watch", "/a")
        self.manager.load("ImageTalker", "/n", {"/out": "/a"})
        eventually(lambda: port_connections("/manager", "/a"), 10.0, "connected")
        peer.stop(signal.SIGSTOP)
        call("/n", "publish", 20, 1_000_000)
        for topic in ("/b", "/a", ""):
            begin = time.monotonic()
            self.assertTrue(set_config("/n", out=topic).success)
            self.assertLess(time.monotonic() - begin, HELD_UP, topic)
        peer.stop(signal.SIGCONT)

    def test_a_stopped_publisher_holds_up_set_config_for_half_a_second_at_most(self):
        self.manager.load("Listener", "/n", {"/in": "/b"})
        peer = self.start_peer("talk", "100", "/a")
        eventually(lambda: graph.nodes_on("/a")[0], 10.0, "it is registered")
        peer.stop(signal.SIGSTOP)
        begin = time.monotonic()
        self.assertTrue(set_config("/n", **{"in": "/a"}).success)
        self.assertLess(time.monotonic() - begin, HELD_UP)
        peer.stop(signal.SIGCONT)
        eventually(lambda: call("/n", "count") > 10, 10.0, "it is heard when it goes on")

    def test_a_publisher_that_is_killed_while_a_port_moves(self):
        self.start_peer("talk", "1000", "/steady")
        self.manager.load("Listener", "/n")
        for _ in range(2):
            peer = self.start_peer("talk", "1000", "/shaky")
            set_config("/n", **{"in": "/shaky"})
            count = call("/n", "count")
            eventually(lambda count=count: call("/n", "count") > count, 10.0, "it is heard")
            peer.stop(signal.SIGKILL)
            begin = time.monotonic()
            self.assertTrue(set_config("/n", **{"in": "/steady"}).success)
            self.assertTrue(set_config("/n", **{"in": "/shaky"}).success)
            self.assertLess(time.monotonic() - begin, HELD_UP)
            peer.exit_code(20.0)
        self.assertTrue(set_config("/n", **{"in": "/steady"}).success)
        before = call("/n", "senders").get("/steady", 0)
        eventually(lambda: call("/n", "senders").get("/steady", 0) > before, 5.0, "it goes on")


class InsideTest(RewiringTest):
    def test_many_switches_under_load_with_an_outside_listener(self):
        for source in ("/a", "/b"):
            self.manager.load("Talker", f"/talker{source}", {"/talker/out": source})
        self.manager.load("Listener", "/n", {"/in": "/a"})
        peer = self.start_peer("listen", "/a")
        eventually(lambda: call("/talker/a", "connections") == 2, 10.0, "one in, one out")
        for name in ("/talker/a", "/talker/b"):
            call(name, "start", 500.0)
        change = rospy.ServiceProxy("/n/set_config", SetConfig, persistent=True)
        for number in range(250):
            self.assertTrue(change([PortConfig("in", ("/b", "/a")[number % 2])]).success)
        sent = {name: call(name, "stop") for name in ("/talker/a", "/talker/b")}
        change.close()
        eventually(
            lambda: f"/a {sent['/talker/a'] - 1}\n" in peer.output, 10.0, "the outside has all"
        )
        heard = [int(number) for number in re.findall(r"^/a (\d+)$", peer.output, re.M)]
        self.assertEqual(len(heard), len(set(heard)), "doubled outside")
        self.assertEqual(get_statistics("/n").reconfigurations, 250)
        self.assertEqual(get_statistics("/n").callback_errors, 0)
        story = call("/n", "story")
        self.assertEqual(sum(isinstance(event, list) for event in story), 250)
        self.assertGreater(len(story), 250, "messages came between")
        self.assertEqual(port_statistics("/n", "in").dropped, 0)


def port_connections(node, topic):
    return [info for info in graph.bus_info(node) if info[4] == topic and info[2] == "o"]


if __name__ == "__main__":
    rospy.init_node("rewiring_test")
    rostest.rosrun("dyknow", "rewiring", "__main__")
