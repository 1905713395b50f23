#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The bus under the ROS graph: by reference inside, ordinary topics outside."""

from __future__ import annotations

import itertools
import signal

import graph  # first: it makes the test package known
import rospy
import rostest
from graph import PEER, NodeletManagerCase, call, port_statistics
from processes import HELD_UP, Running, eventually, finished
from sensor_msgs.msg import Image
from std_msgs.msg import Header


class BusTest(NodeletManagerCase):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.before = graph.registrations("/manager")

    def tearDown(self):
        super().tearDown()
        # A nodelet's ordinary rospy handles go with its on_shutdown, which unload does not await.
        eventually(lambda: graph.registrations("/manager") == self.before, 5.0, "nothing is left")

    def start(self, *command):
        process = Running(*command)
        self.addCleanup(process.__exit__)
        return process

    def listen(self, topic, message_class=Header):
        """Returns a list to which a topic's messages are added, once this process is connected."""
        heard = []
        subscriber = rospy.Subscriber(topic, message_class, heard.append, tcp_nodelay=True)
        self.addCleanup(subscriber.unregister)
        eventually(lambda: graph.is_fed(topic), 5.0, f"connected to {topic}")
        return heard

    def wait_for_numbers(self, numbers, nodelet):
        numbers = list(numbers)
        eventually(lambda: len(call(nodelet, "received")) >= len(numbers), 10.0, "all arrive")
        self.assertEqual(call(nodelet, "received"), numbers)


class InsideTest(BusTest):
    def test_every_message_on_every_hop_once(self):
        hops = [f"/hop{number}" for number in range(6)]
        self.manager.load("Talker", "/talker", {"/out": hops[0]})
        for number, (source, target) in enumerate(zip(hops, hops[1:])):
            self.manager.load("Relay", f"/relay{number}", {"/in": source, "/out": target})
        self.manager.load("Listener", "/last", {"/in": hops[-1]})
        heard = {hop: self.listen(hop) for hop in (hops[0], hops[3], hops[5])}
        for first in range(0, 2500, 100):
            call("/talker", "publish", first, 100)
            # Outside, a queue of ten holds the messages that the network has not taken yet.
            eventually(
                lambda first=first: call("/last", "count") == first + 100, 5.0, "a hundred more"
            )
        self.wait_for_numbers(range(2500), "/last")
        for number in range(5):
            self.assertEqual(call(f"/relay{number}", "count"), 2500)
        for hop, messages in heard.items():
            numbers = [message.seq for message in messages]
            self.assertEqual(sorted(set(numbers)), numbers, f"{hop}: twice or out of order")
        statistics = port_statistics("/last", "in")
        self.assertEqual((statistics.messages, statistics.dropped), (2500, 0))


class OutsideTest(BusTest):
    def test_serialised_once_and_only_if_somebody_listens(self):
        self.manager.load("Talker", "/talker", {"/out": "/a"})
        self.manager.load("Listener", "/inside", {"/in": "/a"})
        before = call("/talker", "serialisations")
        call("/talker", "publish", 0, 10)
        self.wait_for_numbers(range(10), "/inside")
        self.assertEqual(call("/inside", "identities"), call("/talker", "identities"))
        self.assertEqual(call("/talker", "serialisations"), before)
        heard = [self.listen("/a")]
        peers = [self.start(*PEER, "listen", "/a") for _ in range(2)]
        eventually(lambda: call("/talker", "connections") == 4, 10.0, "one inside, three outside")
        call("/talker", "publish", 10, 10)
        for peer in peers:
            peer.wait_for("/a 19\n")
        eventually(lambda: [m.seq for m in heard[0]] == list(range(10, 20)), 5.0, "all arrive")
        self.assertEqual(call("/talker", "serialisations"), before + 10)

    def test_a_message_that_cannot_be_serialised(self):
        self.manager.load("Talker", "/talker", {"/out": "/a"})
        heard = self.listen("/a")
        eventually(lambda: call("/talker", "connections") == 1, 5.0, "connected")
        self.assertIn("rospy.ROSSerializationException", call("/talker", "publish_nonsense"))
        call("/talker", "publish", 1, 3)
        eventually(lambda: [m.seq for m in heard] == [1, 2, 3], 5.0, "the next ones arrive whole")

    def test_the_command_line_tools(self):
        self.manager.load("Talker", "/talker", {"/out": "/a"})
        self.manager.load("Listener", "/listener", {"/in": "/a"})
        self.assertIn("/a\n", finished(["rostopic", "list"])[1])
        info = finished(["rostopic", "info", "/a"])[1]
        self.assertIn("Type: std_msgs/Header", info)
        self.assertEqual(info.count(" * /manager ("), 2, info)
        eventually(  # rospy connects the process to itself when the master has notified it
            lambda: "INTRAPROCESS" in finished(["rosnode", "info", "/manager"])[1], 5.0, "the link"
        )
        links = [info for info in graph.bus_info("/manager") if info[4] == "/a"]
        self.assertEqual([link[3] for link in links], ["INTRAPROCESS"])
        call("/talker", "start", 100.0)
        hz = self.start("rostopic", "hz", "/a")
        hz.wait_for("average rate: ")
        echo = self.start("rostopic", "echo", "-n", "2", "/a")
        self.assertEqual(echo.exit_code(10.0), 0)
        self.assertIn('frame_id: "/talker"', echo.output)
        call("/talker", "stop")

    def test_of_two_latched_publishers_one_goes(self):
        for number, name in enumerate(("/one", "/two", "/three")):
            self.manager.load("Talker", name, {"/out": "/a"}, latch=True)
            call(name, "publish", number, 1)
        self.manager.unload("/one")
        self.assertIn("\n2\n", self.latched("/a"))
        self.manager.unload("/three")
        self.assertIn("\n1\n", self.latched("/a"))

    @staticmethod
    def latched(topic):
        """The messages that a late subscriber gets."""
        code, output = finished(["rostopic", "echo", "-n", "1", f"{topic}/seq"], 10.0)
        assert code == 0, output
        return f"\n{output}"

    def test_a_latch_of_the_outside_reaches_every_new_connection(self):
        publisher = rospy.Publisher("/a", Header, queue_size=1, latch=True)
        self.addCleanup(publisher.unregister)
        publisher.publish(Header(seq=5))
        self.manager.load("Listener", "/one", {"/in": "/a"})
        self.wait_for_numbers([5], "/one")
        self.manager.load("Listener", "/two", {"/in": "/a"})
        self.wait_for_numbers([5], "/two")
        self.wait_for_numbers([5], "/one")

    def test_outside_listeners_do_not_change_what_the_inside_has(self):
        self.manager.load("Stamper", "/stamper", {"/out": "/a"})
        heard = self.listen("/a", Image)
        call("/stamper", "publish", 3)
        eventually(lambda: len(heard) == 3, 5.0, "all arrive")
        self.assertEqual([message.header.seq for message in heard], [1, 2, 3])
        self.assertEqual(call("/stamper", "headers"), [[4711, None]] * 3)

    def test_an_outside_publisher_that_is_killed_and_comes_back(self):
        self.manager.load("Listener", "/listener", {"/in": "/a"})
        for _ in range(2):
            talker = self.start(*PEER, "talk", "100", "/a")
            before = call("/listener", "count")
            eventually(
                lambda before=before: call("/listener", "count") > before + 10, 10.0, "it is heard"
            )
            talker.stop(signal.SIGKILL)
            talker.exit_code(5.0)
            eventually(lambda: call("/listener", "connections") == 0, 5.0, "it is missed")
        numbers = call("/listener", "received")
        restarts = sum(later <= earlier for earlier, later in zip(numbers, numbers[1:]))
        self.assertEqual(restarts, 1, "in order, but for the second start")

    def test_an_outside_subscriber_that_is_killed_and_comes_back(self):
        self.manager.load("Talker", "/talker", {"/out": "/a"})
        self.manager.load("Listener", "/inside", {"/in": "/a"})
        call("/talker", "start", 200.0)
        for _ in range(2):
            peer = self.start(*PEER, "listen", "/a")
            peer.wait_for("/a ")
            peer.stop(signal.SIGKILL)
            peer.exit_code(5.0)
            eventually(lambda: call("/talker", "connections") == 1, 5.0, "the inside is left")
        sent = call("/talker", "stop")
        self.wait_for_numbers(range(sent), "/inside")

    def test_a_slow_outside_subscriber_holds_up_nobody(self):
        self.manager.load("ImageTalker", "/talker", {"/out": "/a"}, queue_size=5)
        peer = self.start(*PEER, "watch", "/a")
        eventually(lambda: graph.nodes_on("/a")[1], 10.0, "it has registered")
        heard = self.listen("/a", Image)
        call("/talker", "publish", 1, 100)
        peer.wait_for("/a 0 100\n")
        peer.stop(signal.SIGSTOP)
        # 40 messages of a megabyte: more than the sockets and the queue of five hold.
        took = call("/talker", "publish", 40, 1 << 20)
        self.assertLess(took, HELD_UP)
        eventually(lambda: heard[-1].height == 39, 10.0, "the last one arrives elsewhere")
        peer.stop(signal.SIGCONT)
        peer.wait_for("/a 39 1048576\n")

    def test_subscribers_of_any_type_and_of_the_topics_type_together(self):
        for names in (("AnyListener", "Listener"), ("Listener", "AnyListener")):
            with self.subTest(names):
                for name in names:
                    self.manager.load(name, f"/{name}", {"/in": "/a"})
                publisher = rospy.Publisher("/a", Header, queue_size=10)
                eventually(publisher.get_num_connections, 5.0, "connected from outside")
                for number in range(3):
                    publisher.publish(Header(seq=number))
                for name in names:
                    self.wait_for_numbers(range(3), f"/{name}")
                self.assertEqual(call("/AnyListener", "seen_types"), ["std_msgs/Header"])
                publisher.unregister()
                self.manager.unload_all()


class OrdinaryHandleTest(BusTest):
    """rospy's own publishers and subscribers inside a nodelet, on a topic of the bus."""

    LABELS = ("bus_publisher", "rospy_publisher", "bus_subscriber", "rospy_subscriber")

    def setUp(self):
        self.manager.load("Ordinary", "/n")

    def make(self, label):
        kind, role = label.split("_")
        call("/n", f"make_{role}", label, kind, "/a")

    def wait_for(self, label, numbers):
        eventually(
            lambda: len(call("/n", "received", label)) >= len(numbers),
            5.0,
            f"{label} receives {numbers}",
        )
        self.assertEqual(sorted(call("/n", "received", label)), numbers, label)

    def settle(self, labels):
        """Wait until rospy has connected the ordinary handles, after the master's notification."""
        for label in labels:
            eventually(lambda label=label: call("/n", "connections", label) > 0, 5.0, label)

    def test_all_combinations_in_every_order(self):
        for order in itertools.permutations(self.LABELS):
            with self.subTest(order):
                for label in order:
                    self.make(label)
                self.settle(label for label in order if "subscriber" in label)
                numbers = iter(range(100))
                expected = {label: [] for label in order if "subscriber" in label}
                present = list(order)
                # Remove one after another; the remaining ones go on, with each message once.
                for removed in order:
                    for publisher in [label for label in present if "publisher" in label]:
                        sent = [next(numbers) for _ in range(2)]
                        call("/n", "publish", publisher, sent)
                        for subscriber in expected:
                            if subscriber in present:
                                expected[subscriber] += sent
                    for subscriber in expected:
                        if subscriber in present:
                            self.wait_for(subscriber, sorted(expected[subscriber]))
                    call("/n", "remove", removed)
                    present.remove(removed)
                self.assertEqual(graph.nodes_on("/a"), (set(), set()))

    def test_with_peers_outside(self):
        labels = ("rospy_subscriber", "bus_publisher", "rospy_publisher", "bus_subscriber")
        for label in labels:
            self.make(label)
        heard = self.listen("/a")
        speaker = rospy.Publisher("/a", Header, queue_size=10)
        self.addCleanup(speaker.unregister)
        eventually(speaker.get_num_connections, 5.0, "connected")
        eventually(
            lambda: call("/n", "connections", "rospy_publisher") >= 1, 5.0, "it is heard outside"
        )
        call("/n", "publish", "bus_publisher", [0, 1])
        eventually(lambda: len(heard) == 2, 5.0, "heard outside")
        call("/n", "publish", "rospy_publisher", [2, 3])
        eventually(lambda: len(heard) == 4, 5.0, "heard outside")
        speaker.publish(Header(seq=4))
        for label in ("bus_subscriber", "rospy_subscriber"):
            self.wait_for(label, [0, 1, 2, 3, 4])
        eventually(lambda: [message.seq for message in heard] == [0, 1, 2, 3, 4], 5.0, "each once")

    def test_the_connection_header_is_that_of_rospy(self):
        """Compared with the header that this process receives from the same publishers."""
        outside = []
        subscriber = rospy.Subscriber("/a", Header, outside.append)
        self.addCleanup(subscriber.unregister)
        for latch in (False, True):
            call("/n", "make_publisher", "bus_publisher", "bus", "/a", latch)
            call("/n", "make_publisher", "rospy_publisher", "rospy", "/a", latch)
            for label in ("rospy_subscriber", "bus_subscriber"):
                self.make(label)
            self.settle(["rospy_subscriber", "bus_subscriber"])
            eventually(
                lambda: call("/n", "connections", "rospy_publisher") > 0, 5.0, "heard outside"
            )
            del outside[:]
            call("/n", "publish", "bus_publisher", [0])
            self.wait_for("rospy_subscriber", [0])
            eventually(lambda: outside, 5.0, "heard outside")
            expected = outside[0]._connection_header
            self.assertEqual(expected["latching"], str(int(latch)))
            self.assertEqual(call("/n", "header", "rospy_subscriber"), expected)
            call("/n", "publish", "rospy_publisher", [1])
            for label in ("rospy_subscriber", "bus_subscriber"):
                self.wait_for(label, [0, 1])
                self.assertEqual(call("/n", "header", label), expected)
            for label in self.LABELS:
                call("/n", "remove", label)
            eventually(lambda: graph.nodes_on("/a")[0] == set(), 5.0, "no publisher is left")

    def test_an_ordinary_subscriber_of_any_type(self):
        self.make("bus_publisher")
        call("/n", "make_any_subscriber", "any", "/a")
        self.settle(["any"])
        call("/n", "publish", "bus_publisher", [1, 2])
        self.wait_for("any", [1, 2])
        header = call("/n", "header", "any")
        self.assertEqual((header["type"], header["topic"]), ("std_msgs/Header", "/a"))

    def test_an_ordinary_subscriber_outlives_many_publishers_of_the_bus(self):
        call("/n", "make_subscriber", "rospy_subscriber", "rospy", "/a")
        call("/n", "limit_nested_calls", 300)  # of Python, by default 1,000
        try:
            call("/n", "make_and_remove_publishers", 360, "bus", "/a")
            call("/n", "make_publisher", "bus_publisher", "bus", "/a")
            call("/n", "make_subscriber", "second", "rospy", "/a")
            self.settle(["rospy_subscriber", "second"])
            call("/n", "publish", "bus_publisher", [1, 2])
            for label in ("rospy_subscriber", "second"):
                self.wait_for(label, [1, 2])
        finally:
            call("/n", "limit_nested_calls", 1000)

    def test_latched_by_an_ordinary_publisher_where_the_bus_publishes_too(self):
        call("/n", "make_publisher", "before", "rospy", "/a", True)
        call("/n", "publish", "before", [6])
        call("/n", "make_publisher", "bus_publisher", "bus", "/a", True)
        call("/n", "make_publisher", "after", "rospy", "/a", True)
        for number, publisher in ((6, ""), (7, "before"), (8, "after")):
            if publisher:
                call("/n", "publish", publisher, [number])
            for kind in ("rospy", "bus"):
                label = f"{kind}_{number}"
                call("/n", "make_subscriber", label, kind, "/a")
                self.wait_for(label, [number])
                call("/n", "remove", label)
        call("/n", "remove", "bus_publisher")
        call("/n", "make_subscriber", "late", "rospy", "/a")
        self.wait_for("late", [8])


if __name__ == "__main__":
    rospy.init_node("bus_test")
    rostest.rosrun("dyknow", "bus", "__main__")
