#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How messages are counted for the manager: by nodelet managers in one call, or by subscribing."""

from __future__ import annotations

import math
import threading
import time

import rospy
from dyknow_msgs.msg import NodeletCounts, Port, PortCount
from dyknow_msgs.srv import Poll, PollResponse
from graph import NodeletManagerCase, call, connect, poll
from nodelet.srv import NodeletList
from processes import TellingCase, becomes, eventually, run, suspended
from std_msgs.msg import Header

from dyknow.manager.host import ProcessState
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.message_counter import MessageCounter
from dyknow.ros.hosting.peer import POLL_TIMEOUT, Peer, Presence
from dyknow.ros.transport.registrar import Registrar
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.poll_client import PollClient
from dyknow.ros.wire.service_client import ServiceFailed


class ServiceTest(NodeletManagerCase):
    manager_name = "/robot/counted"

    @staticmethod
    def ask(*nodelets):
        """Counts by nodelet and port, as messages and whether one is latched."""
        return {
            each.nodelet: {port.port: (port.messages, port.latched) for port in each.ports}
            for each in poll("/robot/counted", *nodelets).counts
        }

    def test_all_nodelets_in_one_call(self):
        for name in ("/b", "/a"):
            self.manager.load("Talker", name, {"/out": "/said"}, latch=name == "/b")
        self.manager.load("Relay", "/c", {"/in": "/said"})
        self.manager.load("Introspector", "/no_ports")
        none = (0, False)
        expected = {"/a": {"out": none}, "/b": {"out": none}, "/c": {"in": none, "out": none}}
        self.assertEqual(self.ask("/a", "/b", "/c", "/no_ports"), {**expected, "/no_ports": {}})
        call("/a", "publish", 0, 3)
        call("/b", "publish", 0, 2)
        becomes(lambda: self.ask("/c")["/c"]["in"], (5, False))
        expected = {"/a": {"out": (3, False)}, "/b": {"out": (2, True)}}
        self.assertEqual(self.ask("/b", "/a", "/nobody"), expected)
        self.assertEqual(self.ask(), {})
        (counts,) = poll("/robot/counted", "/c").counts
        self.assertGreater(counts.uptime.to_sec(), 0)
        self.assertEqual(counts.reconfigurations, 0)
        connect("/b", out="")
        call("/b", "publish", 0, 4)
        (counts,) = poll("/robot/counted", "/b").counts
        self.assertEqual((counts.reconfigurations, counts.ports[0].dropped), (1, 4))
        (counts,) = poll("/robot/counted", "/c").counts
        self.assertEqual([each.direction for each in counts.ports], [Port.IN, Port.OUT])
        self.manager.unload("/a")
        self.assertEqual(self.ask("/a"), {})
        with self.assertRaisesRegex(ServiceFailed, "4096"):
            self.ask("/a" * 4096)


class Named(Peer):
    """Whichever process offers services of a name."""

    def __init__(self, context, name):
        super().__init__(context, name, False, Presence(ProcessState(name), "not found yet"))

    def _find(self):
        client = PollClient(self.context.master, self.name, False)
        state = ProcessState(self.name, incarnation="1")
        self._found(state, client, client.ask(POLL_TIMEOUT))

    def _missed(self, client, error):
        """The connection is kept for the answer that is late."""


class CountingTest(TellingCase):
    """Nodelet managers of all kinds; this process provides their services."""

    def setUp(self):
        self.peers = {}
        self.awake, self.asked = threading.Event(), []
        self.addCleanup(self.awake.set)

    def offer(self, name, answer):
        for service, service_class in (("list", NodeletList), ("poll", Poll)):
            offered = rospy.Service(f"/{name}/{service}", service_class, answer)
            self.addCleanup(offered.shutdown)

    def counts(self, **wanted):
        """Counts by nodelet, as a host returns them."""
        context = PeerContext(Master(rospy.get_name()))
        numbers, found = {}, {}
        for name, nodelet in wanted.items():
            if name not in self.peers:
                self.peers[name] = Named(context, f"/{name}")
                self.addCleanup(self.peers[name].close)
            numbers[name] = self.peers[name].ask_counts([f"/{nodelet}"])
        deadline = time.monotonic() + 0.5
        for name, number in numbers.items():
            found.update(self.peers[name].counts(number, [f"/{wanted[name]}"], deadline))
        return found

    def messages(self, **wanted):
        """Messages on the port out, by nodelet."""
        return {
            name[1:]: None if counts is None else counts["out"].messages
            for name, counts in self.counts(**wanted).items()
        }

    def counted(self, manager, nodelet, messages):
        """Wait for a count: on a busy machine the answer comes later than a host waits for."""
        becomes(lambda: self.messages(**{manager: nodelet}).get(nodelet, "late"), messages)

    def good(self, request):
        ports = [
            PortCount("in", Port.IN, 1, False, math.nan, 0),
            PortCount("out", Port.OUT, 7, True, 0.5, 0),
        ]
        return PollResponse(counts=[NodeletCounts(nodelet="/there", ports=ports)])

    def hung(self, request):
        """Answers only when the event is set."""
        if request.counted:
            self.asked.append(request.counted)
            self.awake.wait()
        ports = [PortCount("out", Port.OUT, 3, False, math.nan, 0)]
        return PollResponse(counts=[NodeletCounts(nodelet="/late", ports=ports)])

    def test_who_is_there_and_who_is_not(self):
        self.offer("good", self.good)
        for manager, nodelet, messages in (
            ("good", "there", 7),
            ("good", "gone", None),
        ):
            self.counted(manager, nodelet, messages)
        found = {}
        eventually(lambda: found.update(self.counts(good="there")) or found, 5.0, "it is")
        count = found["/there"]["out"]
        self.assertTrue(count.latched)
        self.assertLessEqual(count.asked, count.answered)

    def test_who_hangs_costs_nobody_else_his_answer(self):
        self.offer("good", self.good)
        self.offer("hung", self.hung)
        for _ in range(5):
            becomes(lambda: self.messages(good="there", hung="late"), {"there": 7})
        becomes(lambda: self.asked, [["/late"]])  # while an answer is due, nothing more is asked
        self.awake.set()
        self.counted("hung", "late", 3)


class HearingTest(TellingCase):
    def setUp(self):
        self.hearing = MessageCounter(Registrar())
        self.addCleanup(self.hearing.close)
        self.speaker = self.publisher("/spoken", Header)

    def listen(self, topic="/spoken"):
        counter = self.hearing.listen(topic)
        eventually(counter.count, 5.0, "it listens")
        return counter

    def speak(self, *listeners):
        """Publish until each of the counters has seen something new."""
        before = [each.count().messages for each in listeners]

        def heard():
            self.speaker.publish(Header())
            counts = [each.count().messages for each in listeners]
            return all(count > old for count, old in zip(counts, before))

        eventually(heard, 5.0, "it is heard")

    def test_each_listener_counts_for_itself(self):
        first = self.listen()
        self.speak(first)
        second = self.listen()
        # Some that were published before may come only now; what came before does not count.
        self.assertLess(second.count().messages, first.count().messages)
        self.speak(first, second)
        second.close()
        other = self.listen("/elsewhere")
        self.speak(first)
        self.assertEqual(other.count().messages, 0)

    def test_a_master_that_hangs_holds_up_nobody_who_listens(self):
        first = self.listen()
        self.speak(first)
        master = int(Master(rospy.get_name()).ask("getPid"))
        with suspended(master):
            second = self.hearing.listen("/spoken")
            third = self.hearing.listen("/elsewhere")
            self.speak(first)
            self.assertIsNone(third.count(), "nobody can say that nothing comes")
            third.close()
        eventually(second.count, 10.0, "it listens")
        self.speak(first, second)


if __name__ == "__main__":
    run()
