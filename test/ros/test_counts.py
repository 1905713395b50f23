#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How messages are counted for the manager: by nodelet managers in one call, or by subscribing."""

from __future__ import annotations

import math
import os
import signal
import threading
import unittest

import rospy
import rostest
from dyknow_msgs.msg import NodeletCounts, Port, PortCount, PortStatistics
from dyknow_msgs.srv import GetCounts, GetCountsResponse, GetStatistics, GetStatisticsResponse
from graph import Manager, call
from processes import eventually
from std_msgs.msg import Header

from dyknow.ros.hosting.counts import CountClient, MessageCounter, counts_of
from dyknow.ros.transport.registrar import Registrar
from dyknow.ros.wire.master import Master


def ask(manager: Manager, *nodelets: str):
    """Counts by nodelet and port, as messages and whether one is latched."""
    answer = rospy.ServiceProxy(f"{manager.name}/get_counts", GetCounts)(nodelets)
    return {
        each.nodelet: {port.port: (port.messages, port.latched) for port in each.ports}
        for each in answer.nodelets
    }


class ServiceTest(unittest.TestCase):
    def test_all_nodelets_in_one_call(self):
        with Manager("/robot/counted") as manager:
            for name in ("/b", "/a"):
                manager.load("Talker", name, {"/out": "/said"}, latch=name == "/b")
            manager.load("Relay", "/c", {"/in": "/said"})
            manager.load("Introspector", "/no_ports")
            self.assertEqual(
                ask(manager),
                {
                    "/a": {"out": (0, False)},
                    "/b": {"out": (0, False)},
                    "/c": {"in": (0, False), "out": (0, False)},
                    "/no_ports": {},
                },
            )
            call("/a", "publish", 0, 3)
            call("/b", "publish", 0, 2)
            eventually(lambda: ask(manager, "/c")["/c"]["in"] == (5, False), 5.0, "all arrived")
            self.assertEqual(
                ask(manager, "/b", "/a", "/nobody"),
                {"/a": {"out": (3, False)}, "/b": {"out": (2, True)}},
            )
            proxy = rospy.ServiceProxy("/robot/counted/get_counts", GetCounts)
            (counts,) = proxy(["/c"]).nodelets
            self.assertGreater(counts.uptime.to_sec(), 0)
            self.assertEqual([each.direction for each in counts.ports], [Port.IN, Port.OUT])
            manager.unload("/a")
            self.assertEqual(ask(manager, "/a"), {})
            with self.assertRaisesRegex(rospy.ServiceException, "4096"):
                ask(manager, "/a" * 4096)


class CountingTest(unittest.TestCase):
    """Nodelet managers of all kinds; this process provides their services."""

    def setUp(self):
        self.clients = {}

    def offer(self, name, service_class, handler):
        self.addCleanup(rospy.Service(name, service_class, handler).shutdown)

    def counts(self, wanted):
        """Counts as a host returns them, of nodelets by nodelet manager."""
        for name in wanted:
            if name not in self.clients:
                self.clients[name] = CountClient(Master(rospy.get_name()), name)
                self.addCleanup(self.clients[name].close)
        return counts_of((self.clients[name], wanted[name]) for name in wanted)

    def messages(self, **wanted):
        """Messages on the port out, by nodelet."""
        wanted = {f"/{manager}": [f"/{each}" for each in wanted[manager]] for manager in wanted}
        return {
            name[1:]: None if counts is None else counts["out"].messages
            for name, counts in self.counts(wanted).items()
        }

    def good(self, name, messages=7):
        def answer(request):
            ports = [
                PortCount("in", Port.IN, 1, False, math.nan),
                PortCount("out", Port.OUT, messages, True, 0.5),
            ]
            return GetCountsResponse(nodelets=[NodeletCounts(nodelet="/there", ports=ports)])

        self.offer(f"/{name}/get_counts", GetCounts, answer)

    def hung(self, name):
        """A nodelet manager that answers only when the event is set."""
        awake, asked = threading.Event(), []
        self.addCleanup(awake.set)

        def answer(request):
            asked.append(sorted(request.nodelets))
            awake.wait(60.0)
            ports = [PortCount("out", Port.OUT, 3, False, math.nan)]
            return GetCountsResponse(
                nodelets=[NodeletCounts(nodelet=name, ports=ports) for name in asked[-1]]
            )

        self.offer(f"/{name}/get_counts", GetCounts, answer)
        return awake, asked

    def test_who_is_there_and_who_is_not(self):
        self.good("good")
        self.assertEqual(
            self.messages(good=["there", "gone"], absent=["lost"]),
            {"there": 7, "gone": None, "lost": None},
        )
        (count,) = self.counts({"/good": ["/there"]})["/there"].values()
        self.assertTrue(count.latched)
        self.assertLessEqual(count.asked, count.answered)

    def test_who_hangs_costs_nobody_else_his_answer(self):
        self.good("good")
        awake, asked = self.hung("hung")
        for _ in range(5):
            self.assertEqual(self.messages(good=["there"], hung=["late"]), {"there": 7})
        self.assertEqual(asked, [["/late"]], "while an answer is due, nothing more is asked")
        awake.set()
        eventually(
            lambda: self.messages(hung=["late"]) == {"late": 3}, 10.0, "the answer is picked up"
        )

    def test_one_that_does_not_have_the_service_is_asked_nodelet_by_nodelet(self):
        def answer(request):
            return GetStatisticsResponse(
                ports=[PortStatistics(port="out", direction=Port.OUT, messages=4)]
            )

        self.offer("/old_nodelet/get_statistics", GetStatistics, answer)
        self.assertEqual(
            self.messages(old=["old_nodelet", "other"]), {"old_nodelet": 4, "other": None}
        )


class HearingTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.registrar = Registrar()

    def setUp(self):
        self.hearing = MessageCounter(self.registrar)
        self.addCleanup(self.hearing.close)
        self.publisher = rospy.Publisher("/spoken", Header, queue_size=10)
        self.addCleanup(self.publisher.unregister)

    def speak(self, *listeners):
        """Publish until each of the counters has seen something new."""
        before = [each.count().messages for each in listeners]

        def heard():
            self.publisher.publish(Header())
            counts = [each.count().messages for each in listeners]
            return all(count > old for count, old in zip(counts, before))

        eventually(heard, 5.0, "it is heard")

    def test_each_listener_counts_for_itself(self):
        first = self.hearing.listen("/spoken")
        eventually(first.count, 5.0, "it listens")
        self.speak(first)
        second = self.hearing.listen("/spoken")
        eventually(second.count, 5.0, "it listens")
        # Some that were published before may come only now; what came before does not count.
        self.assertLess(second.count().messages, first.count().messages)
        self.speak(first, second)
        second.close()
        other = self.hearing.listen("/elsewhere")
        eventually(other.count, 5.0, "it listens")
        self.speak(first)
        self.assertEqual(other.count().messages, 0)

    def test_a_master_that_hangs_holds_up_nobody_who_listens(self):
        first = self.hearing.listen("/spoken")
        eventually(first.count, 5.0, "it listens")
        self.speak(first)
        master = int(Master(rospy.get_name()).ask("getPid"))
        os.kill(master, signal.SIGSTOP)
        try:
            second = self.hearing.listen("/spoken")
            third = self.hearing.listen("/elsewhere")
            self.speak(first)
            self.assertIsNone(third.count(), "nobody can say that nothing comes")
            third.close()
        finally:
            os.kill(master, signal.SIGCONT)
        eventually(second.count, 10.0, "it listens")
        self.speak(first, second)


if __name__ == "__main__":
    rospy.init_node("counts_test")
    rostest.rosrun("dyknow", "counts", "__main__")
