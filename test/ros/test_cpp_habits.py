#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Habits of public nodes: they see the same as without live ports, and none of them hangs."""

from __future__ import annotations

import itertools
import os
import signal
import time
from typing import Iterator
from unittest import mock

import graph
from cpp_suite import OURS, RUN
from dyknow_msgs.msg import NodeletChanges, PortConfig
from dyknow_msgs.srv import GetConfig, SetConfig
from graph import Heard, WordsCase, hears
from processes import BUSY, becomes, eventually, finished, run
from rosgraph_msgs.msg import Log, TopicStatistics
from roslib.packages import find_node
from rospy.impl.statistics import SubscriberStatisticsLogger
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from dyknow.guards import NOT_REWIRABLE
from dyknow.ros.nodelets.announcements import TOPIC as NODES_TOPIC
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient

PROGRAM = ("dyknow", "dyknow_cpp_test_habits")
#: Moves of each node with statistics; more in the long run.
MOVES = int(os.environ.get("DYKNOW_TEST_MOVES", 2))


class HabitsCase(WordsCase):
    def call(self, service: str, service_class=Trigger, *args):
        """Calls a service that has to answer in time, once it is there."""
        node = service.rpartition("/")[0]
        eventually(lambda: service in graph.services_of(node), 20.0, f"{service} is there")
        client = ServiceClient(Master("/tests"), service, service_class)
        try:
            return client.call(5.0 * BUSY, *args)
        finally:
            client.close()

    def move(self, node: str, port: str, topic: str) -> None:
        answer = self.call(f"{node}/set_config", SetConfig, [PortConfig(port, topic)])
        self.assertTrue(answer.success, answer.message)

    def stop(self, *nodes: graph.Ended) -> None:
        for node in nodes:
            node.stop()
        for node in nodes:
            self.assertEqual(node.exit_code(5.0), 0, node.output)


class CyclesTest(HabitsCase):
    """roscpp is shut down with the last handle of a node, and started again with the next one."""

    def test_ports_live_in_every_cycle(self):
        told = self.enter(Heard(NODES_TOPIC, NodeletChanges))
        pauses = ("0", "0.05", "0.5", "1", "0")
        node = self.run_process(*RUN, *PROGRAM, "12", *pauses, "__name:=habits", "/in:=/a")
        topics = itertools.cycle(("/b", "/a"))
        heard = "left"
        for cycle, pause in enumerate(pauses, 1):
            with self.subTest(cycle=cycle, pause=pause):
                node.wait_for(f"relay {cycle}\n", 20.0)
                hears("/out", heard, is_whole=True)
                self.assertEqual(graph.poll("/habits", is_node=True).nodelets, ["/habits"])
                told.has(lambda message: message.nodelets)
                del told[:]
                topic = next(topics)
                heard = self.WORDS[topic]
                self.move("/habits", "in", topic)
                hears("/out", heard, is_whole=True)
                told.has(lambda message: message.nodelets)
                del told[:]
                self.move("/habits", "out", "/moved")
                hears("/moved", heard, is_whole=True)
                self.move("/habits", "out", "/out")
                self.assert_registered(topic)
            if cycle < len(pauses):
                node.stop(signal.SIGUSR1)
        self.stop(node)
        becomes(lambda: graph.registered("/habits"), set())

    def assert_registered(self, topic: str) -> None:
        """All that is registered is of this cycle, and known to the process."""
        publishers = [NODES_TOPIC, "/out", "/rosout"]

        def registered():
            every = graph.registrations("/habits")
            return every["publishers"], every["subscribers"]

        becomes(registered, (publishers, [topic]))
        graph.bus_info("/habits")  # under the address that the master has


class EndTest(HabitsCase):
    def test_a_program_that_starts_roscpp_and_returns_ends_in_order(self):
        for _ in range(5):
            code, output = finished([*RUN, *PROGRAM, "start"])
            self.assertEqual(code, 0, output)


class StatisticsTest(HabitsCase):
    """roscpp publishes statistics of messages, by a publisher that ends with a subscription."""

    #: Command, in-port and out-port of each node.
    NODES = {
        "/relaying": (("topic_tools", "relay", "/a", "/copied"), "/a", "/copied"),
        "/choosing": (("topic_tools", "mux", "/chosen", "/a", "/spare"), "/a", "/chosen"),
        "/habits": ((*PROGRAM, "0", "-1", "/in:=/a"), "in", "out"),
    }

    def setUp(self):
        super().setUp()
        self.parameter("/enable_statistics", True)
        # Else this process publishes its own.
        patch = mock.patch.object(SubscriberStatisticsLogger, "is_enabled", return_value=False)
        patch.start()
        self.addCleanup(patch.stop)

    def statistics_come(self, topic: str) -> None:
        """Wait until each node has published those of the topic that it is on now."""
        came: set[str] = set()

        def all_came() -> bool:
            # A subscriber that stays would be deaf to a node that advertises the topic again. Each
            # node publishes once a second; one that is always first must not hide another.
            with Heard("/statistics", TopicStatistics) as messages:
                until = time.monotonic() + 3.0
                while time.monotonic() < until and not came >= set(self.NODES):
                    time.sleep(0.05)
                    came.update(each.node_sub for each in list(messages) if each.topic == topic)
            return came >= set(self.NODES)

        eventually(all_came, 20.0, f"statistics of {topic} come", lambda: came)

    def test_they_are_advertised_before_a_message_comes(self):
        """roscpp would do it under the lock of a callback, and wait there for another lock."""
        node = self.run_process(*RUN, *PROGRAM, "0", "-1", "/in:=/silent", "__name:=habits")
        becomes(lambda: "/statistics" in graph.registrations("/habits")["publishers"], True)
        self.stop(node)

    def test_moves_and_unsubscribing(self):
        nodes = [
            self.run_process(*RUN, *command, f"__name:={name[1:]}")
            for name, (command, _, _) in self.NODES.items()
        ]
        self.statistics_come("/a")
        topics = itertools.cycle(("/b", "/a"))
        for number in range(MOVES):
            topic = next(topics)
            for name, (_, port, _) in self.NODES.items():
                self.move(name, port, topic)
            self.statistics_come(topic)
            for name, (_, _, port) in self.NODES.items():
                moved = f"{name}/{number}"
                self.move(name, port, moved)
                hears(moved, self.WORDS[topic], is_whole=True)
        self.assertTrue(self.call("/habits/again").success)
        self.statistics_come(topic)
        self.stop(*nodes)


class ViewTest(HabitsCase):
    """A node sees itself as it would without live ports, and roscpp answers its mistakes."""

    @staticmethod
    def is_live() -> bool:
        return f"publishers {NODES_TOPIC}" in graph.registered("/habits")

    def both(self) -> Iterator[None]:
        """Runs the node without live ports, then with them."""
        for command in (find_node(*PROGRAM), [*RUN, *PROGRAM]):
            node = self.run_process(*command, "0", "-1", "__name:=habits")
            if command[-1] == PROGRAM[-1]:
                eventually(self.is_live, 20.0, "its ports are live")
            yield
            self.stop(node)

    def test_topics(self):
        views = []
        for _ in self.both():
            self.call("/habits/seen")
            with Heard("/rosout", Log) as lines:
                seen = self.call("/habits/seen").message
                line = lines.has(lambda line: line.msg == "seen")
                views.append((seen, sorted(line.topics)))
        self.assertEqual(views[1], views[0])
        self.assertIn("/out", views[0][1])

    def test_mistakes(self):
        plain, live = (self.call("/habits/refused").message for _ in self.both())
        self.assertIn("without a callback", plain)
        self.assertEqual(live, plain)

    def test_a_connection_outlives_the_former_one_of_its_descriptor(self):
        """roscpp closes it, and its client gets no answer."""
        node = self.run_process(*RUN, *PROGRAM, "0", "-1", "__name:=habits")
        self.assertTrue(self.call("/habits/accepted").success)
        self.stop(node)

    def test_it_advertises_while_it_ends(self):
        """As in a callback that a shutdown overtakes; a refused handle would end in an abort."""
        node = self.run_process(*RUN, *PROGRAM, "0", "-1", "__name:=habits")
        eventually(self.is_live, 20.0, "its ports are live")
        self.stop(node)
        self.assertIn("published at the end: 1", node.output)


def types(changes: NodeletChanges) -> dict[str, str]:
    """The types of ports in an announcement of one node."""
    return {port.name: port.datatype for each in changes.nodelets for port in each.ports}


class AgainTest(HabitsCase):
    """A node makes its handles again; its ports stay where they were connected."""

    def setUp(self):
        super().setUp()
        command = (*RUN, *PROGRAM, "0", "-1", "/in:=/a", "__name:=habits")
        self.node = self.run_process(*command)

    def tearDown(self):
        self.stop(self.node)

    def test_with_the_same_options(self):
        """Into which roscpp has written the resolved names."""
        self.move("/habits", "in", "/b")
        self.move("/habits", "out", "/moved")
        self.call("/habits/again")
        hears("/moved", "right", is_whole=True)
        self.move("/habits", "in", "/a")
        hears("/moved", "left", is_whole=True)
        self.assertEqual(graph.topics_of_ports("/habits"), {"in": "/a", "out": "/moved"})

    def test_with_another_type(self):
        told = self.enter(Heard(NODES_TOPIC, NodeletChanges, types))
        self.call("/habits/retyped")
        told.has(lambda found: found.get("out") == "std_msgs/Header")
        self.publisher("/headers", Header)
        self.move("/habits", "out", "/headers")


class OwnServicesTest(HabitsCase):
    def test_they_win(self):
        """A node's own services are there, even if they have names of DyKnow's."""
        node = self.run_process(*RUN, *PROGRAM, "0", "-1", "__name:=habits")
        self.call("/habits/get_config", GetConfig)
        self.assertTrue(self.call("/habits/taken").success)
        for name in ("poll", "get_config"):
            self.assertEqual(self.call(f"/habits/{name}").message, "its own")
            node.wait_for(f"'/habits/{name}'")
        self.stop(node)
        becomes(lambda: graph.registered("/habits"), set())


class HelpTest(HabitsCase):
    def test_no_node_is_started(self):
        for option in ("-h", "--help"):
            code, output = finished([*OURS, option])
            self.assertEqual((code, output.partition(" ")[0]), (0, "usage:"), output)


class StandaloneTest(HabitsCase):
    """A nodelet that runs alone has the name of its node, which may have ports by then."""

    def test_ports(self):
        node = self.run_process(
            *(*RUN, "nodelet", "nodelet", "standalone", "dyknow_cpp_test/Eager"),
            *("__name:=eager", "/in:=/a"),
        )
        hears("/out", "left", is_whole=True)
        self.call("/eager/get_config", GetConfig)
        self.assertEqual(
            graph.topics_of_ports("/eager"), {"~early": "/eager/early", "out": "/out", "in": "/a"}
        )
        self.move("/eager", "in", "/b")
        hears("/out", "right", is_whole=True)
        self.move("/eager", "~early", "/earlier")
        becomes(lambda: graph.nodes_on("/earlier")[0], {"/eager"})
        self.assertNotIn("ERROR", node.output)


class OwnNodeletsTest(HabitsCase):
    """A node that is no nodelet manager may load nodelets, which have other names."""

    NODELET = "/loading_rectify_mono"

    def test_they_are_announced_and_polled(self):
        """Under the parameters of their node."""
        command = (*RUN, "image_proc", "image_proc", "__name:=loading", "_rewirable:=false")
        node = self.run_process(*command)
        told = self.enter(Heard(NODES_TOPIC, NodeletChanges, graph.named))
        told.has(lambda nodelets: self.NODELET in nodelets)
        nodelets = graph.poll("/loading", is_node=True).nodelets
        self.assertIn(self.NODELET, nodelets)
        self.assertNotIn("/loading", nodelets)  # it has no ports
        answer = graph.set_config(self.NODELET, image_rect="/moved")
        self.assertIn(NOT_REWIRABLE, answer.message)
        self.stop(node)


if __name__ == "__main__":
    run()
