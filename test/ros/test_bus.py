#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The bus under the ROS graph: by reference inside, ordinary topics outside; lazy; counted."""

from __future__ import annotations

import itertools
import json
import math
import signal
import threading
import time

import graph  # first: it makes the test package known
import rospy
from dyknow_msgs.msg import NodeletCounts, Port, PortCount
from dyknow_msgs.srv import Poll, PollResponse
from dyknow_test.puppet import Call
from graph import Heard, Manager, NodeletManagerCase, call, connect, is_linked, peer, poll
from nodelet.srv import NodeletList
from processes import HELD_UP, TellingCase, becomes, eventually, finished, run, suspended
from sensor_msgs.msg import Image
from std_msgs.msg import Header, String

from dyknow.manager.host import ProcessState
from dyknow.periodic import Workers
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.listening import TopicCounter
from dyknow.ros.hosting.peer import POLL_TIMEOUT, Peer, Presence
from dyknow.ros.transport.registrar import Registrar
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.poll_client import PollClient
from dyknow.ros.wire.service_client import ServiceFailed


def number_of(message):
    return message.seq


class BusTest(NodeletManagerCase):
    def load(self, **ports):
        """Load nodelets, named by type and port, on /a."""
        for name, port in ports.items():
            self.manager.load(name, f"/{name.lower()}", {f"/{port}": "/a"})

    def received(self, nodelet, numbers):
        becomes(lambda: call(nodelet, "received"), list(numbers))


class OutsideTest(BusTest):
    def test_serialised_once_and_only_if_somebody_listens(self):
        self.load(Talker="out", Listener="in")
        before = call("/talker", "serialisations")
        call("/talker", "publish", 0, 10)
        self.received("/listener", range(10))
        self.assertEqual(call("/listener", "identities"), call("/talker", "identities"))
        self.assertEqual(call("/talker", "serialisations"), before)
        peers = [self.run_process(*peer("listen", "/a")) for _ in range(2)]
        heard = self.enter(Heard("/a", note=number_of))
        eventually(lambda: is_linked("/a", 4), 10.0, "one inside, three outside")
        self.assertEqual(call("/talker", "connections"), 4)
        call("/talker", "publish", 10, 10)
        for each in peers:
            each.wait_for("/a 19\n")
        becomes(heard.copy, list(range(10, 20)))
        self.assertEqual(call("/talker", "serialisations"), before + 10)

    def test_a_message_that_cannot_be_serialised(self):
        self.load(Talker="out")
        heard = self.enter(Heard("/a", note=number_of))
        self.assertIn("rospy.ROSSerializationException", call("/talker", "publish_nonsense"))
        call("/talker", "publish", 1, 3)
        becomes(heard.copy, [1, 2, 3])

    def test_the_command_line_tools(self):
        self.load(Talker="out", Listener="in")
        self.assertIn("/a\n", finished(["rostopic", "list"])[1])
        info = finished(["rostopic", "info", "/a"])[1]
        self.assertIn("Type: std_msgs/Header", info)
        self.assertEqual(info.count(" * /manager ("), 2, info)
        # rospy connects the process to itself when the master has notified it.
        becomes(
            lambda: [link[3] for link in graph.bus_info("/manager") if link[4] == "/a"],
            ["INTRAPROCESS"],
        )
        self.assertIn("INTRAPROCESS", finished(["rosnode", "info", "/manager"])[1])
        call("/talker", "start", 100.0)
        self.run_process("rostopic", "hz", "/a").wait_for("average rate: ")
        code, output = finished(["rostopic", "echo", "-n", "2", "/a"])
        self.assertEqual(code, 0)
        self.assertIn('frame_id: "/talker"', output)

    def test_of_two_latched_publishers_one_goes(self):
        for number, name in enumerate(("/one", "/two", "/three")):
            self.manager.load("Talker", name, {"/out": "/a"}, latch=True)
            call(name, "publish", number, 1)
        for gone, latched in (("/one", 2), ("/three", 1)):
            self.manager.unload(gone)
            self.assertEqual(graph.comes("/a", Header).seq, latched)

    def test_a_latch_of_the_outside_reaches_every_new_connection(self):
        self.publisher("/a", Header, latch=True).publish(Header(seq=5))
        for names in (["/one"], ["/one", "/two"]):
            self.manager.load("Listener", names[-1], {"/in": "/a"})
            for name in names:
                self.received(name, [5])

    def test_outside_listeners_do_not_change_what_the_inside_has(self):
        self.load(Stamper="out")
        heard = self.enter(Heard("/a", Image, lambda image: image.header.seq))
        call("/stamper", "publish", 3)
        becomes(heard.copy, [1, 2, 3])
        self.assertEqual(call("/stamper", "headers"), [[4711, None]] * 3)

    def test_an_outside_publisher_that_is_killed_and_comes_back(self):
        self.load(Listener="in")
        for _ in range(2):
            talker = self.run_process(*peer("talk", "100", "/a"))
            before = call("/listener", "count")
            eventually(lambda b=before: call("/listener", "count") > b + 10, 10.0, "it is heard")
            talker.stop(signal.SIGKILL)
            becomes(lambda: call("/listener", "connections"), 0)
            numbers = call("/listener", "received")[before:]
            self.assertEqual(sorted(set(numbers)), numbers)

    def test_an_outside_subscriber_that_is_killed_and_comes_back(self):
        self.load(Talker="out", Listener="in")
        call("/talker", "start", 200.0)
        for _ in range(2):
            listener = self.run_process(*peer("listen", "/a"))
            listener.wait_for("/a ")
            listener.stop(signal.SIGKILL)
            becomes(lambda: call("/talker", "connections"), 1)
        self.received("/listener", range(call("/talker", "stop")))

    def test_a_slow_outside_subscriber_holds_up_nobody(self):
        self.manager.load("ImageTalker", "/talker", {"/out": "/a"}, queue_size=5)
        slow = self.run_process(*peer("watch", "/a"))
        heard = self.enter(Heard("/a", Image, lambda image: image.height))
        eventually(lambda: is_linked("/a", 2), 10.0, "both are connected")
        call("/talker", "publish", 1, 100)
        slow.wait_for("/a 0 100\n")
        slow.stop(signal.SIGSTOP)
        # 40 messages of a megabyte: more than the sockets and the queue of five hold.
        self.assertLess(call("/talker", "publish", 40, 1 << 20), HELD_UP)
        becomes(lambda: heard[-1:], [39])
        slow.stop(signal.SIGCONT)
        slow.wait_for("/a 39 1048576\n")

    def test_subscribers_of_any_type_and_of_the_topics_type_together(self):
        for names in (("AnyListener", "Listener"), ("Listener", "AnyListener")):
            with self.subTest(names):
                self.load(**dict.fromkeys(names, "in"))
                publisher = self.publisher("/a", Header)
                eventually(publisher.get_num_connections, 5.0, "connected from outside")
                for number in range(3):
                    publisher.publish(Header(seq=number))
                for name in names:
                    self.received(f"/{name.lower()}", range(3))
                self.assertEqual(call("/anylistener", "seen_types"), ["std_msgs/Header"])
                publisher.unregister()
                self.manager.unload_all()


class OrdinaryHandleTest(BusTest):
    """rospy's own publishers and subscribers inside a nodelet, on a topic of the bus."""

    PUBLISHERS = ("bus_publisher", "rospy_publisher")
    SUBSCRIBERS = ("bus_subscriber", "rospy_subscriber")

    def setUp(self):
        self.manager.load("Ordinary", "/n")
        self.service = rospy.ServiceProxy("/n/call", Call, persistent=True)

    def tearDown(self):
        self.service.close()
        super().tearDown()

    def call(self, method, *args):
        """Call a method of the nodelet, over one connection."""
        return json.loads(self.service(String(json.dumps([method, args]))).data)

    def make(self, *labels, latch=()):
        for label in labels:
            kind, role = label.split("_")[:2]
            self.call(f"make_{role}", label, kind, "/a", *latch)

    def all_come(self, label, numbers):
        becomes(lambda: sorted(self.call("received", label)), list(numbers))

    def settle(self, *labels):
        """Wait until rospy has connected the ordinary handles, after the master's notification."""
        for label in labels:
            eventually(lambda label=label: self.call("connections", label), 5.0, label)

    def test_all_combinations_in_every_order(self):
        for order in itertools.permutations(self.PUBLISHERS + self.SUBSCRIBERS):
            with self.subTest(order):
                self.make(*order)
                self.settle(*self.SUBSCRIBERS)
                numbers = itertools.count()
                expected = {label: [] for label in self.SUBSCRIBERS}
                present = list(order)
                # Remove one after another; the remaining ones go on, with each message once.
                for removed in order:
                    sent = {each: [next(numbers), next(numbers)] for each in self.PUBLISHERS}
                    present_subscribers = [each for each in expected if each in present]
                    for publisher in [each for each in present if each in sent]:
                        self.call("publish", publisher, sent[publisher])
                        for subscriber in present_subscribers:
                            expected[subscriber] += sent[publisher]
                    for subscriber in present_subscribers:
                        self.all_come(subscriber, sorted(expected[subscriber]))
                    self.call("remove", removed)
                    present.remove(removed)
                becomes(lambda: graph.nodes_on("/a"), (set(), set()))

    def test_with_peers_outside(self):
        self.make("rospy_subscriber", "bus_publisher", "rospy_publisher", "bus_subscriber")
        self.settle(*self.SUBSCRIBERS)
        heard = self.enter(Heard("/a", note=number_of))
        for publisher, numbers in zip(self.PUBLISHERS, ([0, 1], [2, 3])):
            self.call("publish", publisher, numbers)
            becomes(heard.copy, list(range(numbers[-1] + 1)))
        speaker = self.publisher("/a", Header)
        eventually(lambda: is_linked("/a", 2), 5.0, "connected both ways")
        eventually(lambda: speaker.get_num_connections() == 2, 5.0, "to this process as well")
        speaker.publish(Header(seq=4))
        for label in self.SUBSCRIBERS:
            self.all_come(label, range(5))
        becomes(heard.copy, list(range(5)))

    def test_the_connection_header_is_that_of_rospy(self):
        """Compared with the header that this process receives from the same publishers."""
        for latch in (False, True):
            self.make(*self.PUBLISHERS, latch=[latch])
            self.make(*self.SUBSCRIBERS)
            self.settle(*self.SUBSCRIBERS)
            with Heard("/a", note=lambda message: message._connection_header) as headers:
                self.call("publish", "bus_publisher", [0])
                self.all_come("rospy_subscriber", [0])
                expected = headers.has(bool)
            self.assertEqual(expected["latching"], str(int(latch)))
            self.assertEqual(self.call("header", "rospy_subscriber"), expected)
            self.call("publish", "rospy_publisher", [1])
            for label in self.SUBSCRIBERS:
                self.all_come(label, [0, 1])
                self.assertEqual(self.call("header", label), expected)
            for label in self.PUBLISHERS + self.SUBSCRIBERS:
                self.call("remove", label)
            becomes(lambda: graph.nodes_on("/a"), (set(), set()))

    def test_an_ordinary_subscriber_of_any_type(self):
        self.make("bus_publisher")
        self.call("make_any_subscriber", "any", "/a")
        self.settle("any")
        self.call("publish", "bus_publisher", [1, 2])
        self.all_come("any", [1, 2])
        header = self.call("header", "any")
        self.assertEqual((header["type"], header["topic"]), ("std_msgs/Header", "/a"))

    def test_an_ordinary_subscriber_outlives_many_publishers_of_the_bus(self):
        labels = ("rospy_subscriber", "rospy_subscriber_2")
        self.make(labels[0])
        self.call("limit_nested_calls", 300)  # of Python, by default 1,000
        try:
            self.call("make_and_remove_publishers", 360, "bus", "/a")
            self.make("bus_publisher", labels[1])
            self.settle(*labels)
            self.call("publish", "bus_publisher", [1, 2])
            for label in labels:
                self.all_come(label, [1, 2])
        finally:
            self.call("limit_nested_calls", 1000)

    def test_latched_by_an_ordinary_publisher_where_the_bus_publishes_too(self):
        self.make("rospy_publisher", latch=[True])
        self.call("publish", "rospy_publisher", [6])
        self.make("bus_publisher", "rospy_publisher_2", latch=[True])
        for number, publisher in ((6, ""), (7, "rospy_publisher"), (8, "rospy_publisher_2")):
            if publisher:
                self.call("publish", publisher, [number])
            for label in self.SUBSCRIBERS:
                self.make(label)
                self.all_come(label, [number])
                self.call("remove", label)
        self.call("remove", "bus_publisher")
        self.make("rospy_subscriber")
        self.all_come("rospy_subscriber", [8])


class LazyTest(NodeletManagerCase):
    """Nodelets that work only while they have subscribers, in their process or in another."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.other = Manager("/other")
        cls.addClassCleanup(cls.other.__exit__)

    def tearDown(self):
        self.other.unload_all()
        super().tearDown()

    def load(self, **parameters):
        self.manager.load("Lazy", "/lazy", {"/in": "/a", "/out": "/b"}, **parameters)
        self.told = []

    def tells(self, event, number):
        """Wait for the next event that the lazy nodelet notes."""
        self.told.append([event, "/b", number])
        becomes(lambda: call("/lazy", "story"), self.told)

    def listen(self, manager, name):
        manager.load("Listener", name, {"/in": "/b"})

    def test_a_chain_over_two_processes(self):
        self.manager.load("Talker", "/talker", {"/out": "/t0"})
        chain = [f"/lazy{number}" for number in range(4)]
        for number, name in enumerate(chain):
            manager = (self.manager, self.other)[number % 2]
            manager.load("Lazy", name, {"/in": f"/t{number}", "/out": f"/t{number + 1}"})

        def settle(is_listening):
            state = [is_listening, int(is_listening)]
            for name in chain:
                becomes(lambda n=name: [call(n, "is_listening"), call(n, "connections")], state)

        settle(False)
        self.manager.load("Listener", "/end", {"/in": "/t4"})
        settle(True)
        call("/talker", "publish", 1, 1)
        eventually(lambda: 1 in call("/end", "received"), 5.0, "through the whole chain")
        self.manager.unload("/end")
        settle(False)

    def test_inside_and_outside_mixed(self):
        """Each process counts once."""
        self.load()
        self.listen(self.manager, "/one")
        self.tells("subscribe", 1)
        self.listen(self.manager, "/two")
        self.listen(self.other, "/three")
        self.tells("subscribe", 2)
        listener = self.run_process(*peer("listen", "/b"))
        self.tells("subscribe", 3)
        self.manager.unload("/one")
        self.other.unload("/three")
        self.tells("unsubscribe", 2)
        self.manager.unload("/two")
        self.tells("unsubscribe", 1)
        self.assertTrue(call("/lazy", "is_listening"))
        listener.stop(signal.SIGKILL)
        self.tells("unsubscribe", 0)
        becomes(lambda: call("/lazy", "is_listening"), False)

    def test_ordinary_subscribers_of_the_process_are_no_peer_of_their_own(self):
        self.load()
        self.manager.load("Ordinary", "/n")
        call("/n", "make_subscriber", "rospy", "rospy", "/b")
        self.tells("subscribe", 1)
        call("/n", "make_subscriber", "bus", "bus", "/b")
        self.assertEqual(call("/lazy", "connections"), 1)
        call("/n", "remove", "rospy")
        self.assertEqual(call("/lazy", "connections"), 1)
        call("/n", "remove", "bus")
        self.tells("unsubscribe", 0)

    def test_each_newcomer_alone_is_welcomed(self):
        for latch in (False, True):
            self.load(latch=latch)
            self.listen(self.manager, "/inside")
            becomes(lambda: call("/inside", "senders"), {"welcome": 1})
            with Heard("/b", note=lambda message: message.frame_id) as heard:
                becomes(heard.copy, ["welcome"])
                self.assertEqual(call("/lazy", "connections"), 2)
                self.assertEqual(call("/inside", "senders"), {"welcome": 1})
            self.manager.unload_all()


class ServiceTest(NodeletManagerCase):
    @staticmethod
    def ask(*nodelets):
        """Counts by nodelet and port, as messages and whether one is latched."""
        return {
            each.nodelet: {port.port: (port.messages, port.latched) for port in each.ports}
            for each in poll("/manager", *nodelets).counts
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
        (counts,) = poll("/manager", "/c").counts
        self.assertGreater(counts.busy, 0.0)
        self.assertEqual((counts.cpu, counts.memory), (0.0, 0), "it shares the process")
        self.assertGreater(counts.uptime.to_sec(), 0)
        self.assertEqual(counts.reconfigurations, 0)
        connect("/b", out="")
        call("/b", "publish", 0, 4)
        (counts,) = poll("/manager", "/b").counts
        self.assertEqual((counts.reconfigurations, counts.ports[0].dropped), (1, 4))
        (counts,) = poll("/manager", "/c").counts
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
            PortCount("in", Port.IN, 1, False, math.nan, 0, 0),
            PortCount("out", Port.OUT, 7, True, 0.5, 0, 100),
        ]
        return PollResponse(counts=[NodeletCounts(nodelet="/there", ports=ports)])

    def hung(self, request):
        """Answers only when the event is set."""
        if request.counted:
            self.asked.append(request.counted)
            self.awake.wait()
        ports = [PortCount("out", Port.OUT, 3, False, math.nan, 0, 0)]
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
        becomes(lambda: self.asked, [["/late"]])  # no more requests while an answer is due
        self.awake.set()
        self.counted("hung", "late", 3)


class HearingTest(TellingCase):
    def setUp(self):
        self.registrar = Registrar()
        self.registrations = Workers("registering to count messages", 1)
        self.addCleanup(self.registrations.close, 0.5)
        self.speaker = self.publisher("/spoken", Header)

    def counter(self, topic):
        return TopicCounter(topic, self.registrar, self.registrations)

    def listen(self, topic="/spoken"):
        counter = self.counter(topic)
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
        # Some that were published before may come only now; earlier arrivals do not count.
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
            second = self.counter("/spoken")
            third = self.counter("/elsewhere")
            self.speak(first)
            self.assertIsNone(third.count(), "nobody can say that nothing comes")
            third.close()
        eventually(second.count, 10.0, "it listens")
        self.speak(first, second)


if __name__ == "__main__":
    run()
