#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Live ports of C++ nodelets that know nothing of them: moves, names, refusals, counts."""

from __future__ import annotations

import contextlib
import itertools
import os
import statistics
import threading
import time
import unittest
from pathlib import Path
from unittest import mock
from urllib.parse import urlsplit
from xmlrpc.server import SimpleXMLRPCServer

import graph
import rosgraph
import rospy
from cpp_suite import (
    FLAWLESS,
    OURS,
    PRELOADED,
    STOCK,
    Camera,
    CppManager,
    Mover,
    flaws,
    report,
    start,
)
from dyknow_msgs.msg import NodeletChanges, Port, PortConfig
from dyknow_msgs.srv import GetConfig, SetConfig
from dynamic_reconfigure.msg import Config, DoubleParameter
from dynamic_reconfigure.srv import Reconfigure
from geometry_msgs.msg import Vector3
from graph import Heard, connect, refusal, set_config, set_config_pairs, topics_of_ports
from nodelet.srv import NodeletLoad
from processes import BUSY, Running, TellingCase, becomes, eventually, free_port, run, suspended
from rospy.impl import tcpros_pubsub
from sensor_msgs.msg import Image
from std_msgs.msg import Float64, Header, String
from std_srvs.srv import Trigger

from dyknow import errors
from dyknow.errors import HostError
from dyknow.guards import NOT_REWIRABLE, SYSTEM_TOPICS, Guards
from dyknow.nodelet import leases
from dyknow.ros.nodelets.announcements import TOPIC as NODES_TOPIC
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.messages import guards_message
from dyknow.ros.wire.poll_client import PollClient
from dyknow.ros.wire.service_client import ServiceClient

RATE = 1000
#: Messages of one test; many in the long run.
COUNT = int(os.environ.get("DYKNOW_TEST_MESSAGES", RATE))
#: Seconds of a lease that has run out when it is granted.
RUN_OUT = 1e-6
MANAGER = "/cpp_manager"


class CppCase(TellingCase):
    """Tests in one C++ nodelet manager, in which each leaves nothing."""

    command: tuple[str, ...] = ()

    @classmethod
    def setUpClass(cls) -> None:
        cls.manager = CppManager(MANAGER, *cls.command)
        cls.addClassCleanup(cls.manager.__exit__)

    def tearDown(self) -> None:
        self.assertFalse(self.manager.has_ended, self.manager.output)
        self.manager.unload_all()

    def load(self, kind: str, port: str, topic: str, name: str = "", **parameters) -> None:
        """Load a nodelet with one port, by default under the name of its type."""
        self.manager.load(kind, name or f"/{kind.lower()}", {f"/{port}": topic}, **parameters)

    def mover(self, nodelet: str, port: str) -> Mover:
        return self.enter(Mover(nodelet, port))

    def sends(self, count: int) -> None:
        """Let the source send all its messages."""
        start("/source")
        becomes(lambda: report("/source")["sent"], count)

    def all_arrive(self, count: int) -> None:
        """Everything comes to the sink once, in order and by reference."""
        becomes(lambda: report("/sink")["received"], count, 30.0)
        self.assertEqual(flaws("/sink"), FLAWLESS)


class MoveTest(CppCase):
    """Nothing is lost, doubled, reordered or copied at 1 kHz while ports move."""

    def moves_while_sending(self, count: int, *sources: str, step) -> None:
        """Repeat a step until all sources have sent their messages."""
        for source in sources:
            start(source)
        times = []
        for topic in itertools.cycle(("/b", "/a")):
            before = time.monotonic()
            step(topic)
            times.append(time.monotonic() - before)
            if all(report(source)["sent"] == count for source in sources):
                break
        median, longest = statistics.median(times) * 1e3, max(times) * 1e3
        print(f"{self.id()}: {len(times)} moves, {median:.1f} ms (longest {longest:.0f} ms)")
        self.assertGreater(len(times), 1)

    def test_an_out_port(self):
        self.manager.load("Sink", "/sink", {"/in": "/a", "/second": "/b"}, second=True)
        self.load("Source", "out", "/a", count=COUNT, rate=RATE)
        self.moves_while_sending(COUNT, "/source", step=self.mover("/source", "out"))
        self.all_arrive(COUNT)
        counts = graph.port_statistics("/source", "out")
        self.assertEqual((counts.messages, counts.dropped), (COUNT, 0))
        self.assertGreater(counts.rate, 0.0)

    def test_an_in_port_between_two_sources(self):
        for multithreaded in (False, True):
            with self.subTest(multithreaded=multithreaded):
                for source, topic in (("/left", "/a"), ("/right", "/b")):
                    self.load("Source", "out", topic, source, count=COUNT, rate=RATE)
                self.load("Sink", "in", "/a", mt=multithreaded)
                self.moves_while_sending(COUNT, "/left", "/right", step=self.mover("/sink", "in"))
                self.assertEqual(flaws("/sink"), FLAWLESS)
                self.assertGreater(report("/sink")["switches"], 1)
                self.manager.unload_all()

    def test_an_in_port_with_a_small_queue_and_many_threads(self):
        """It hears its new topic after every move, whichever thread takes which callback."""
        for source, topic in (("/left", "/a"), ("/right", "/b")):
            self.load("Source", "out", topic, source, count=100 * COUNT, rate=RATE)
            start(source)
        self.load("Sink", "in", "/a", mt=True, delay=0.005, queue_size=1)
        move = self.mover("/sink", "in")

        def received() -> int:
            return graph.port_statistics("/sink", "in").messages

        for topic in itertools.islice(itertools.cycle(("/b", "/a")), 40):
            move(topic)
            before = received()
            eventually(lambda n=before: received() > n + 2, 5.0, f"messages of {topic} come")

    def test_an_in_port_that_comes_back_from_a_silent_topic(self):
        """Before it has left the first one, which has both of its connections for a moment."""
        self.load("Source", "out", "/a", count=COUNT, rate=RATE)
        self.load("Sink", "in", "/a")
        move = self.mover("/sink", "in")

        def there_and_back(topic: str) -> None:
            move("/silent")
            move("/a")

        self.moves_while_sending(COUNT, "/source", step=there_and_back)
        self.all_arrive(COUNT)

    def test_both_ends_with_a_slow_receiver_that_has_a_backlog(self):
        self.load("Sink", "in", "/a", delay=0.005, queue_size=COUNT)
        self.load("Source", "out", "/a", count=COUNT, rate=RATE)
        move_in, move_out = self.mover("/sink", "in"), self.mover("/source", "out")

        def move_both(topic: str) -> None:
            move_in(topic)
            move_out(topic)

        self.moves_while_sending(COUNT, "/source", step=move_both)
        # Not from its report, which waits in its queue for all that came before.
        self.assertLess(graph.port_statistics("/sink", "in").messages, COUNT)
        self.all_arrive(COUNT)

    def test_an_out_port_that_publishes_by_value(self):
        """Its messages are still on their way, by roscpp's thread, when it moves."""
        self.manager.load("Sink", "/sink", {"/in": "/a", "/second": "/b"}, second=True)
        self.load("Source", "out", "/a", count=COUNT, rate=RATE, by_value=True)
        self.moves_while_sending(COUNT, "/source", step=self.mover("/source", "out"))
        becomes(lambda: report("/sink")["received"], COUNT, 30.0)
        found = flaws("/sink")
        self.assertEqual({**found, "copied": 0}, FLAWLESS)

    def test_a_disconnected_out_port_drops(self):
        self.load("Sink", "in", "/a")
        self.load("Source", "out", "/a", count=10, rate=RATE)
        self.mover("/source", "out")("")
        self.sends(10)
        counts = graph.port_statistics("/source", "out")
        self.assertEqual((counts.messages, counts.dropped, counts.topic), (0, 10, ""))
        (polled,) = graph.poll(MANAGER, "/source").counts
        self.assertEqual((polled.ports[0].dropped, polled.reconfigurations), (10, 1))
        self.assertEqual(report("/source")["listeners"], 0)
        self.assertEqual(report("/sink")["received"], 0)

    def test_a_latched_message_comes_with_every_connection(self):
        self.load("Source", "out", "/a", latch=True)
        self.load("Source", "out", "/b", "/other")
        self.load("Sink", "in", "/b")
        self.sends(1)
        self.mover("/source", "out")("/b")  # a publisher and a listener of the process are there
        becomes(lambda: report("/sink")["received"], 1)
        sink, source = graph.poll(MANAGER, "/sink", "/source").counts
        self.assertTrue(source.ports[0].latched)
        self.assertGreater(sink.busy, 0.0)
        self.assertEqual([(each.cpu, each.memory) for each in (sink, source)], [(0.0, 0)] * 2)

    def test_a_latched_message_that_is_published_during_the_move_comes_too(self):
        ghost = rosgraph.Master("/ghost")
        ghost.registerSubscriber("/b", Header._type, "http://localhost:1")  # waited for in vain
        self.addCleanup(ghost.unregisterSubscriber, "/b", "http://localhost:1")
        self.load("Source", "out", "/a", latch=True)
        self.load("Sink", "in", "/b")
        mover = threading.Thread(target=self.mover("/source", "out"), args=("/b",))
        mover.start()
        becomes(lambda: report("/sink")["publishers"], 1)
        self.sends(1)
        mover.join()
        becomes(lambda: report("/sink")["received"], 1)

    def test_an_in_port_never_meets_an_out_port_of_the_same_change(self):
        """It comes to where that was, or leaves where it comes, while a peer is waited for."""
        ghost = rosgraph.Master("/ghost")
        ghost.registerSubscriber("/b", Header._type, "http://localhost:1")  # it never comes
        self.addCleanup(ghost.unregisterSubscriber, "/b", "http://localhost:1")
        endless = {"count": 100 * COUNT, "rate": RATE}
        for at, to in (("/b", "/a"), ("/b", "/c"), ("/c", "/a")):
            for kept in (False, True):
                self.manager.unload_all()
                with self.subTest(at=at, to=to, kept=kept):
                    ports = {"/out": "/a", "/in": at}
                    kind = {"by_value": kept, "latch": kept}
                    self.manager.load("Source", "/both", ports, listens=True, **endless, **kind)
                    self.load("Source", "out", to, "/other", **endless)
                    self.load("Sink", "in", "/a")  # latched messages are kept for those to come
                    start("/both")
                    start("/other")
                    becomes(lambda: report("/sink")["received"] > 0, True)
                    connect("/both", **{"out": "/b", "in": to})
                    becomes(lambda: report("/both")["others"] > 0, True)
                    self.assertEqual(report("/both")["own"], 0)

    def test_who_joins_the_old_topic_is_no_subscriber_any_more(self):
        """A lazy nodelet would go on working for it: no disconnect callback follows."""
        self.load("Source", "out", "/a", watched=True, latch=True)
        self.sends(1)
        self.load("Sink", "in", "/c")
        move_out, move_in = self.mover("/source", "out"), self.mover("/sink", "in")
        move_in("/d")
        self.enter(Heard("/a"))  # outside: the old registration stays for a while
        becomes(lambda: report("/source")["watchers"], 1)
        move_out("/b")
        move_in("/a")
        self.assertEqual(report("/source")["watchers"], 0)
        self.assertEqual(report("/sink")["received"], 0)  # nor of its latched message
        move_in("/b")
        becomes(lambda: report("/source")["watchers"], 1)

    def test_a_newcomer_does_not_stand_for_a_subscriber_that_has_yet_to_connect(self):
        """An out-port waits for those that the master knew, whoever else connects meanwhile."""
        for nodelet in ("/eager", "/second"):
            self.manager.load("Eager", nodelet, {})
        may_connect = threading.Event()

        def connect_late(*args: object) -> None:
            may_connect.wait()
            connect_now(*args)

        connect_now = tcpros_pubsub.robust_connect_subscriber
        with mock.patch.object(tcpros_pubsub, "robust_connect_subscriber", connect_late):
            self.enter(Heard("/late", String))
            self.addCleanup(may_connect.set)
            # Its own in-port is there at once; the second nodelet joins the first on the topic.
            for nodelet in ("/eager", "/second"):
                before = time.monotonic()
                connect(nodelet, **{"in": "/late", "out": "/late"})
                self.assertGreaterEqual(time.monotonic() - before, 0.5, nodelet)

    def test_outside_subscribers_miss_nothing(self):
        """Unless they connect later than a move waits for, as they may on a busy machine."""

        def misses_nothing() -> bool:
            self.load("Source", "out", "/a", count=400, rate=500)
            topics = [Heard(topic, note=lambda message: message.seq) for topic in ("/a", "/b")]
            start("/source")
            with Mover("/source", "out") as move:
                for topic in ("/b", "/a"):
                    move(topic)
                    time.sleep(0.3)  # as long as the old registration lingers
            eventually(lambda: 399 in [*topics[0], *topics[1]], 10.0, "the last one is heard")
            numbers = sorted([*topics[0], *topics[1]])
            self.manager.unload_all()
            for each in topics:
                each.close()
            return numbers == list(range(400))

        self.assertTrue(any(misses_nothing() for _ in range(5)))


if COUNT > RATE:

    class PreloadedMoveTest(MoveTest):
        """In the stock nodelet manager, with the library preloaded."""

        command = PRELOADED


class PortTest(CppCase):
    """Ports as the services return them."""

    def has_topics(self, nodelet: str, **topics: str) -> None:
        found = topics_of_ports(nodelet)
        self.assertEqual({port: found.get(port) for port in topics}, topics)

    def test_names(self):
        self.manager.load(
            "Names",
            "/robot/names",
            {
                "/robot/words": "/said",
                "/robot/left": "/right",
                "/robot/resolved": "/found",
                "/absolute": "/given",
                "/robot/again": "/kept",
            },
        )
        ports = {port.name: port for port in graph.get_config("/robot/names")}
        self.assertEqual(
            {name: port.topic for name, port in ports.items()},
            {
                "words": "/said",
                "camera/image_raw": "/robot/camera/image_raw",
                "~echo": "/robot/names/echo",
                "/tf": "/tf",
                "left/image": "/right/image",
                "resolved": "/found",
                "resolved/compressed": "/found/compressed",
                "alone/compressed": "/robot/alone/compressed",
                "/absolute": "/given",
                "/absolute/compressed": "/given/compressed",
                "annotated": "/robot/annotated",
                "seen": "/robot/seen",
                "form/compressed": "/robot/form/compressed",
                "camera_info": "/robot/camera_info",
                "loop_out": "/robot/loop",
                "loop_in": "/robot/loop",
                "again": "/kept",
                "text": "/robot/text",
                "point": "/robot/point",
                "verdict": "/robot/verdict",
            },
        )
        self.assertEqual(ports["loop_in"].direction, Port.IN)
        self.assertEqual(ports["text"].datatype, "std_msgs/String")
        moves = {"/robot/words": "spoken", "~echo": "~inner", "/absolute": "/moved"}
        connect("/robot/names", **moves)
        topics = {"words": "/robot/spoken", "~echo": "/robot/names/inner"}
        topics["/absolute/compressed"] = "/moved/compressed"
        self.has_topics("/robot/names", **topics)
        self.assertIn("publishers /robot/spoken", graph.registered(MANAGER))

    def test_names_are_not_those_of_a_former_nodelet_of_the_name(self):
        remapped = {"/image": "/absolute", "/names/image": "/tf"}
        self.manager.load("image_proc/resize", "/names", remapped)
        self.manager.unload("/names")
        self.manager.load("Names", "/names")
        self.has_topics("/names", **{"/absolute": "/absolute", "/tf": "/tf"})

    def test_what_image_transport_adds_goes_with_the_image(self):
        self.manager.load("Names", "/names", {"/resolved": "/found"})
        for config, compressed in (
            ({"resolved": "/moved"}, "/moved/compressed"),
            ({"resolved": ""}, ""),
            ({"resolved": "/back"}, "/back/compressed"),
            ({"resolved": "/again", "resolved/compressed": "/own"}, "/own"),
            ({"resolved": "/further"}, "/own"),
        ):
            connect("/names", **config)
            self.has_topics("/names", **{**config, "resolved/compressed": compressed})

    def test_an_image_that_comes_compressed_alone(self):
        self.manager.load("Names", "/names")
        for topic, *config in (
            ("/moved/compressed", ("alone", "/moved")),
            ("/own", ("alone", "/a"), ("alone/compressed", "/own")),
            ("/other", ("alone/compressed", "/other"), ("alone", "/b")),
            ("/third", ("/alone", "/c"), ("/alone/compressed", "/third")),
            ("/fourth", ("/alone/compressed", "/fourth"), ("alone", "/d")),
            ("/e/compressed", ("/alone", "/e")),
        ):
            answer = set_config_pairs("/names", *config)
            self.assertTrue(answer.success, answer.message)
            self.has_topics("/names", **{"alone/compressed": topic})

    def test_a_form_of_an_image_that_is_subscribed_to_by_its_own_name(self):
        """As image_transport's Subscriber does, whose names roscpp remaps by themselves."""
        for remappings, compressed in (
            ({"/form": "/names/disconnected/form"}, ""),
            ({"/form": "/cam/y"}, "/cam/y/compressed"),
            ({"/form": "/cam/y", "/form/compressed": "/own"}, "/own"),
            ({}, "/form/compressed"),
        ):
            with self.subTest(remappings=remappings):
                self.manager.load("Names", "/names", remappings)
                self.has_topics("/names", **{"form/compressed": compressed})
                for port, image in (("form", "/cam/x"), ("/form", "/cam/z")):
                    connect("/names", **{port: image})
                    self.has_topics("/names", **{"form/compressed": f"{image}/compressed"})
                self.assertNotIn("form", topics_of_ports("/names"))
                self.manager.unload("/names")

    def test_camera_info_goes_with_the_image_that_was_subscribed_to_before_it(self):
        """Other images of both directions are in its namespace."""
        self.manager.load("Names", "/robot/names")
        connect("/robot/names", seen="/other/seen")
        self.has_topics("/robot/names", camera_info="/other/camera_info")

    def test_a_port_to_come(self):
        """A lazy nodelet has no port yet, but the load names its topic."""
        self.load("image_proc/resize", "image", "/lazy/disconnected/image", "/lazy")
        self.assertNotIn("image", topics_of_ports("/lazy"))
        connect("/lazy", image="/cam/image_raw")
        self.has_topics("/lazy", image="/cam/image_raw")
        self.assertIn("unknown port 'imag'", set_config("/lazy", imag="/x").message)
        self.enter(Camera("/cam", 8))
        self.assertEqual(width_on("/lazy/image"), 8)
        ports = {port.name: port for port in graph.get_config("/lazy")}
        self.assertEqual(ports["image"].datatype, "sensor_msgs/Image")

    def test_a_port_to_come_that_the_code_calls_by_a_global_name(self):
        """So it is called when it comes; an image that is moved then takes its form along."""
        for name in ("/global", "global"):
            with self.subTest(name):
                self.load("Source", "global", "/source/disconnected/global", late=True)
                connect("/source", **{name: "/moved"})
                start("/source")
                form = {"/global": "/moved", "/global/compressed": "/moved/compressed"}
                self.has_topics("/source", **form)
                self.assertNotIn("global", topics_of_ports("/source"))
                self.manager.unload("/source")

    def test_a_misspelt_port_is_none_to_come(self):
        """Even if the load has the name as well."""
        misspelt = {"echo": "~echo", "tf": "/tf", "loop": "loop_in or loop_out"}
        self.manager.load("Names", "/robot/names", {f"/robot/{port}": "/x" for port in misspelt})
        before = topics_of_ports("/robot/names")
        for port, near in misspelt.items():
            answer = set_config("/robot/names", **{port: "/y"})
            self.assertFalse(answer.success)
            self.assertRegex(answer.message, f"unknown port '{port}'.*; did you mean {near}\\?")
        self.assertIn("unknown port ''", set_config("/robot/names", **{"": "/y"}).message)
        self.assertEqual(topics_of_ports("/robot/names"), before)

    def test_a_port_by_a_longer_name(self):
        self.manager.load("Names", "/robot/names")
        before = set(topics_of_ports("/robot/names"))
        connect("/robot/names", **{"names/echo": "/x"})
        self.has_topics("/robot/names", **{"~echo": "/x"})
        self.assertEqual(set(topics_of_ports("/robot/names")), before)

    def test_changes_are_announced_and_counted(self):
        told = self.enter(Heard(NODES_TOPIC, NodeletChanges, graph.named))

        def is_told(change) -> None:
            del told[:]
            change()
            told.has(lambda nodelets: "/source" in nodelets)

        is_told(lambda: self.load("Source", "out", "/a", count=7, rate=RATE))
        is_told(lambda: connect("/source", out="/b"))
        start("/source")
        becomes(lambda: graph.poll(MANAGER, "/source").counts[0].ports[0].messages, 7)
        (counts,) = graph.poll(MANAGER, "/source").counts  # alone in its process
        self.assertGreater(counts.cpu, 0.0)
        self.assertGreater(counts.memory, 0)
        is_told(lambda: self.manager.unload("/source"))
        becomes(lambda: graph.poll(MANAGER, "/source").counts, [])
        becomes(lambda: [each for each in graph.services_of(MANAGER) if "/source" in each], [])

    def test_a_rate_begins_anew_after_a_pause(self):
        self.load("Source", "out", "/a", count=10, rate=500)
        rounds = itertools.count(1)

        def rate():
            return graph.port_statistics("/source", "out").rate

        def is_high():
            """Send some after a pause of two seconds, over which that would be 10 Hz at most."""
            self.sends(10 * next(rounds))
            return rate() > 10.0

        self.sends(10 * next(rounds))
        becomes(rate, 0.0)
        # A look that comes late sees a lower rate: then there is another pause.
        eventually(lambda: is_high() or becomes(rate, 0.0), 60.0, "the rate is high")

    def test_a_nodelet_manager_with_ports_announces_itself_too(self):
        def topics(changes: NodeletChanges) -> dict[str, list[str]]:
            return {each.nodelet: [port.topic for port in each.ports] for each in changes.nodelets}

        manager = self.enter(CppManager("/early"))
        with Heard(NODES_TOPIC, NodeletChanges, topics) as told:
            manager.load("Eager", "/eager")
            told.has(lambda found: "/eager" in found)
            connect(manager.name, **{"~early": "/earlier"})
            told.has(lambda found: "/earlier" in found.get(manager.name, ()))
        with Heard(NODES_TOPIC, NodeletChanges, graph.named) as newcomer:
            newcomer.has(lambda nodelets: nodelets == ["/eager", manager.name])

    def test_a_lazy_nodelet(self):
        for name, width in (("/cam", 8), ("/cam2", 16)):
            self.enter(Camera(name, width))
        names = {"camera/image_raw": "/cam/image_raw", "camera/camera_info": "/cam/camera_info"}
        remappings = {f"/{port}": topic for port, topic in names.items()}
        self.manager.load("image_proc/crop_decimate", "/crop", remappings)
        self.load("image_proc/resize", "image", "/camera_out/image_raw", "/resize")
        self.assertEqual(width_on("/resize/image"), 8)
        for name, width in (("/cam2", 16), ("/cam", 8)):
            # While it has no subscriber.
            connect("/crop", **{port: port.replace("camera", name, 1) for port in names})
            self.assertEqual(width_on("/resize/image"), width)
        becomes(lambda: graph.nodes_on("/cam/image_raw")[1], set())

    def test_what_a_lazy_nodelet_adds_is_where_its_image_was_moved(self):
        """Before its first subscription."""
        self.enter(Camera("/cam", 8))
        image = {"/camera/image_raw": "/crop/disconnected/camera/image_raw"}
        self.manager.load("image_proc/crop_decimate", "/crop", image)
        connect("/crop", **{"camera/image_raw": "/cam/image_raw"})
        self.assertEqual(width_on("/camera_out/image_raw"), 8)
        self.has_topics("/crop", **{"camera/camera_info": "/cam/camera_info"})

    def test_what_comes_before_its_image_is_where_the_image_was_moved(self):
        """A publisher has the topics of image_transport in the order of their plug-ins."""
        self.load("Source", "late", "/source/disconnected/late", late=True)
        connect("/source", late="/cam/x")
        start("/source")
        self.has_topics("/source", **{"late": "/cam/x", "late/compressed": "/cam/x/compressed"})

    def test_a_dynamic_reconfigure_server(self):
        self.enter(Camera("/cam", 8))
        self.load("image_proc/resize", "image", "/cam/image_raw", "/resize")
        self.assertEqual(width_on("/resize/image"), 8)
        updates = "~parameter_updates"
        self.has_topics("/resize", **{updates: "/resize/parameter_updates"})
        connect("/resize", **{updates: "/elsewhere"})

        def scales(config) -> float:
            return {each.name: each.value for each in config.doubles}["scale_width"]

        told = self.enter(Heard("/elsewhere", Config, scales))
        told.has(lambda scale: scale == 1.0)  # its last message
        change = Config(doubles=[DoubleParameter("scale_width", 0.5)])
        rospy.ServiceProxy("/resize/set_parameters", Reconfigure)(change)
        becomes(lambda: width_on("/resize/image"), 4)
        told.has(lambda scale: scale == 0.5)


def width_on(topic: str) -> int:
    return rospy.wait_for_message(topic, Image, 20.0 * BUSY).width


class ReconfigureTest(CppCase):
    """The callback of nodelets that are written with dyknow/node_handle.h."""

    def means(self, topic: str) -> Heard:
        """The numbers on a topic from now on."""
        return self.enter(Heard(topic, Float64, lambda number: number.data))

    def publish(self, topic: str, *numbers: float) -> None:
        """Publish numbers to the nodelet's port."""
        publisher = self.publisher(topic, Float64)
        eventually(publisher.get_num_connections, 5.0, "connected")
        for number in numbers:
            publisher.publish(number)

    def test_it_is_called_between_the_last_old_and_the_first_new_message(self):
        self.load("Smoother", "in", "/one")
        means = self.means("/out")
        self.publish("/one", 1.0, 3.0)
        becomes(means.copy, [1.0, 2.0])
        connect("/smoother", **{"in": "/other"})
        self.publish("/other", 10.0, 20.0)
        becomes(lambda: means[-2:], [10.0, 15.0])  # it begins again
        connect("/smoother", out="/elsewhere")
        means = self.means("/elsewhere")
        self.publish("/other", 30.0)
        becomes(means.copy, [30.0])  # it hears of its out-port too

    def notes(self) -> list[str]:
        """What a listener has received, and been told of its in-ports."""
        return rospy.ServiceProxy("/listener/notes", Trigger)().message.splitlines()

    def told(self) -> list[str]:
        return [note for note in self.notes() if note.startswith("told")]

    def load_listener(self) -> None:
        self.manager.load("Listener", "/listener", {"/in": "/one", "/second": "/two"})

    def test_the_last_call_says_where_the_ports_are(self):
        """Also that of an earlier change, which has waited for a topic that is silent."""
        self.load_listener()
        self.enter(graph.Talker("/other", String("new")))
        connect("/listener", **{"in": "/silent"})
        connect("/listener", second="/other")
        becomes(lambda: len(self.told()), 2)
        self.assertEqual(self.told()[-1], "told /silent /other")

    def test_a_subscription_that_is_made_anew_before_its_first_message(self):
        """The change that it was waiting for is announced all the same."""
        self.load_listener()
        connect("/listener", **{"in": "/silent"})
        rospy.ServiceProxy("/listener/again", Trigger)()
        becomes(self.told, ["told /silent /two"])

    def test_no_message_of_an_old_topic_comes_after_it(self):
        """Though the new topic of one of several in-ports is silent."""
        self.load_listener()
        self.enter(graph.Talker("/two", String("old")))
        becomes(lambda: "old" in self.notes(), True)
        connect("/listener", **{"in": "", "second": "/silent"})
        becomes(lambda: graph.nodes_on("/two")[1], set())
        self.assertEqual(self.notes()[-1], "told  /silent")

    def test_no_message_of_an_old_topic_comes_after_the_call_for_a_later_change(self):
        """That call says where all ports are, also one that waits for a topic that is silent."""
        self.load_listener()
        self.enter(graph.Talker("/one", String("old")))
        becomes(lambda: "old" in self.notes(), True)
        connect("/listener", **{"in": "/silent"})
        connect("/listener", second="")
        becomes(lambda: graph.nodes_on("/one")[1], set())
        notes = self.notes()
        self.assertNotIn("old", notes[notes.index(self.told()[0]) :])

    def test_without_the_library_it_is_never_called(self):
        stock = self.enter(CppManager("/stock", *STOCK))
        stock.load("Smoother", "/plain", {"/in": "/one", "/out": "/plain_out"})
        means = self.means("/plain_out")
        self.publish("/one", 4.0)
        becomes(means.copy, [4.0])
        self.assertNotIn("/plain/set_config", graph.services_of("/stock"))


class RefusalTest(CppCase):
    """All or nothing, in the words of the Python proxy."""

    def setUp(self):
        self.manager.load("Source", "/n", {"/out": "/a"})

    def refused(self, answer, *problems):
        """Problems of the entries, all at once."""
        self.refused_for(answer, errors.InvalidConfiguration("/n", problems))

    def refused_for(self, answer, problem):
        self.assertEqual((answer.success, answer.message), (False, str(problem)))
        self.assertEqual(topics_of_ports("/n"), {"out": "/a"})
        self.assertEqual(graph.get_statistics("/n").reconfigurations, 0)

    def mismatch(self, topic, datatype="std_msgs/String"):
        problem = errors.TypeMismatch(topic, "std_msgs/Header (port 'out')", datatype)
        self.refused(set_config("/n", out=topic), problem)

    def published(self, topic, message_class):
        publisher = self.publisher(topic, message_class)
        eventually(lambda: graph.nodes_on(topic)[0], 5.0, f"{topic} is registered")
        return publisher

    def test_everything_at_once(self):
        self.refused(
            set_config_pairs("/n", ("out", "/a//b"), ("lens", "/x"), ("out", "/y")),
            errors.DuplicatePort("out"),
            errors.InvalidName("/a//b", "topic name"),
            errors.UnknownPort("lens", ["out"]),
        )

    def test_types_of_topics(self):
        """Those of publishers and subscribers that are there, outside and inside."""
        self.published("/outside", String)
        self.mismatch("/outside")
        self.manager.load("Names", "/names", {"/text": "/inside"})
        self.mismatch("/inside")
        self.published("/vectors", Vector3)
        connect("/names", point="/vectors")  # geometry_msgs/Point: equal checksums
        for topic, gone, present in (("/one", String, Header), ("/two", Header, String)):
            publisher = self.published(topic, gone)
            publisher.unregister()
            self.enter(Heard(topic, present))
            becomes(lambda t=topic: [len(each) for each in graph.nodes_on(t)], [0, 1])
        problem = errors.TypeMismatch("/two", "std_msgs/Header (port 'out')", "std_msgs/String")
        refused = errors.InvalidConfiguration("/n", [problem])
        self.assertEqual(refusal("/n", "out", "/two"), str(refused))
        self.assertEqual(topics_of_ports("/n"), {"out": "/a"})
        connect("/n", out="/one")

    def test_nodes_that_answer_wrongly(self):
        """They say nothing of their topics, or the names of types that there cannot be."""
        server = SimpleXMLRPCServer(("localhost", 0), logRequests=False)
        server.register_function(lambda caller: [1, "", self.subscriptions], "getSubscriptions")
        server.register_function(lambda *_: [1, "", 0], "publisherUpdate")
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        for undo in (server.server_close, thread.join, server.shutdown):
            self.addCleanup(undo)
        node, uri = rosgraph.Master("/odd"), f"http://localhost:{server.server_address[1]}/"
        for number, self.subscriptions in enumerate((0, "odd", ["/odd_2"], [["/odd_3"]], [[]])):
            with self.subTest(self.subscriptions):
                node.registerSubscriber(f"/odd_{number}", "*", uri)
                self.addCleanup(node.unregisterSubscriber, f"/odd_{number}", uri)
                connect("/n", out=f"/odd_{number}")
        connect("/n", out="/a")
        self.subscriptions = [["/odd_0", "long/" + 300000 * "x"]]
        self.assertIn("carries long/xxx", refusal("/n", "out", "/odd_0"))

    @contextlib.contextmanager
    def guarded(self, **guards):
        """Guards that hold for a while, of which one refuses strings of 21 characters."""
        graph.poll(MANAGER, guards=[guards_message(Guards(string_length=20, **guards))])
        try:
            yield
        finally:
            graph.poll(MANAGER, guards=[guards_message(Guards())])

    def test_guards(self):
        topic = "/robot/left/wheel"
        why = "it matches '/robot/*' of the deny list (denied_topics)"
        with self.guarded(denied_topics=("/robot/*",), array_length=2):
            self.refused(set_config("/n", out=topic), errors.Denied(f"topic '{topic}'", why))
            limit = errors.LimitExceeded("characters in a string", 21, 20)
            self.refused_for(set_config("/n", out="/" + 20 * "ä"), limit)
            limit = errors.LimitExceeded("entries in an array", 3, 2)
            self.refused_for(set_config_pairs("/n", *zip("abc", ("/a", "/b", "/c"))), limit)

    def test_an_allow_list_need_not_name_topics_of_every_process(self):
        with self.guarded(allowed_topics=(("/robot/*",),)):
            why = "it matches no pattern of the allow list (allowed_topics)"
            self.refused(set_config("/n", out="/x"), errors.Denied("topic '/x'", why))
            for topic in sorted(SYSTEM_TOPICS):  # refused for their types, if at all
                self.assertNotIn("allow list", set_config("/n", out=topic).message)

    def test_read_only(self):
        denied = errors.Denied(
            "connecting ports of '/n'", "DyKnow runs read-only (parameter read_only)"
        )
        with self.guarded(read_only=True):
            self.refused_for(set_config("/n", out="/x"), denied)


class RewirableTest(TellingCase):
    def test_a_flag_that_is_none(self):
        """It does not open ports that it may have been meant to close."""
        manager = self.enter(CppManager("/flagged", *OURS, "_rewirable:=0"))
        manager.load("Source", "/source")
        self.addCleanup(manager.unload_all)
        answer = set_config("/source", out="/x")
        denied = errors.Denied("connecting ports of '/source'", NOT_REWIRABLE)
        self.assertEqual((answer.success, answer.message), (False, str(denied)))
        self.assertIn("'~rewirable' is 0: expected true or false", manager.output)


class LeaseTest(CppCase):
    """Which messages pass on a topic of a claim, by the leases that a DyKnow manager grants."""

    def lease(
        self, duration: float, nodelet: str = "/source", host: str = "", port: str = "", **request
    ) -> None:
        """Grant a lease for so many seconds, in which a nodelet publishes on ``/claim``."""
        uri = urlsplit(rospy.get_node_uri())
        request.setdefault("topics", ["/claim"])
        request.setdefault("nodelets", [nodelet])
        uri = uri._replace(netloc=f"{host or uri.hostname}:{port or uri.port}").geturl()
        clock = 0.0
        with contextlib.closing(
            PollClient(Master("/dyknow_manager"), self.manager.name, False)
        ) as client:
            while True:  # until a request confirms the clock that an answer has just had
                answer = client.ask(
                    5.0 * BUSY, uri=uri, confirmed=clock, duration=duration, **request
                )
                if answer.clock < clock + leases.PROBE_AFTER:
                    break
                clock = answer.clock

    def end_lease(self) -> None:
        self.lease(1.0, topics=[], nodelets=[])

    def tearDown(self):
        self.end_lease()
        super().tearDown()

    def dropped(self) -> int:
        return graph.port_statistics("/source", "out").dropped

    def test_another_form_of_the_messages(self):
        """image_transport's, on a topic below: it comes from the same nodelets."""
        self.load("Source", "out", "/claim/compressed", count=1)
        self.lease(60.0)
        self.sends(1)
        self.assertEqual(self.dropped(), 0)
        self.end_lease()
        self.lease(RUN_OUT)
        self.sends(2)
        self.assertEqual(self.dropped(), 1)
        self.lease(60.0, "/another")  # which has replaced it meanwhile
        self.sends(3)
        self.assertEqual(self.dropped(), 2)

    def test_a_process_that_is_held_up_while_its_manager_is_gone_goes_on(self):
        self.load("Source", "out", "/claim", count=1)
        sent = itertools.count(1)

        def goes_on() -> bool:
            self.end_lease()
            self.lease(2.0, port=free_port())
            time.sleep(2.5)  # it is extended, unless the process is held up already
            before = self.dropped()
            with suspended(self.manager.pid):
                time.sleep(3.0)
            self.sends(next(sent))
            return self.dropped() == before

        eventually(goes_on, 20.0, "it publishes after three seconds")

    def test_a_latched_message(self):
        """The last one that passed is kept for subscribers to come."""
        self.load("Source", "out", "/claim", latch=True, count=1)
        self.sends(1)
        self.lease(RUN_OUT)
        self.sends(2)
        self.assertEqual(self.dropped(), 1)
        self.lease(60.0)
        heard = self.enter(Heard("/claim", note=lambda message: message.seq))
        becomes(heard.copy, [0])

    def test_a_latched_message_and_a_lease_that_has_run_out(self):
        """Subscribers that come meanwhile do not get it, only the next one after a renewal."""
        self.load("Source", "out", "/claim", latch=True, watched=True, count=1)
        self.sends(1)
        self.lease(RUN_OUT)
        heard = self.enter(Heard("/claim", note=lambda message: message.seq))
        becomes(lambda: report("/source")["watchers"], 1)
        self.lease(60.0)
        self.sends(2)
        becomes(heard.copy, [1])

    def test_a_latched_message_of_a_port_that_moves_to_a_claim(self):
        """Neither what was latched before nor what is latched during the move comes there."""
        ghost = rosgraph.Master("/ghost")
        ghost.registerSubscriber("/claim", Header._type, "http://localhost:1")  # it never comes
        self.addCleanup(ghost.unregisterSubscriber, "/claim", "http://localhost:1")
        self.load("Source", "out", "/a", latch=True, count=1)
        self.load("Source", "out", "/claim", "/other")
        self.load("Sink", "in", "/claim")
        self.sends(1)
        self.lease(RUN_OUT)
        mover = threading.Thread(target=self.mover("/source", "out"), args=("/claim",))
        mover.start()
        becomes(lambda: report("/source")["listeners"], 1)
        self.sends(2)
        mover.join()
        self.assertEqual(report("/sink")["received"], 0)

    @unittest.skipIf(os.geteuid(), "root may mount, others may not")
    def test_it_ends_though_the_first_address_of_the_manager_refuses(self):
        """A node listens at one address, and its host's name may have several."""
        hosts = self.make_folder() / "hosts"
        present = Path("/etc/hosts").read_text()  # has the name of this host, too
        hosts.write_text(f"::1 localhost\n127.0.0.1 localhost\n{present}")
        mounted = ("unshare", "--mount", "sh", "-c", 'mount --bind "$0" /etc/hosts && exec "$@"')
        self.manager = self.enter(CppManager("/other_hosts", *mounted, str(hosts), *OURS))
        self.load("Source", "out", "/claim", count=100 * COUNT, rate=100.0)
        self.lease(1.0, host="localhost")
        start("/source")
        eventually(self.dropped, 20.0, "the lease ends")


class HungMasterTest(TellingCase):
    """A ROS master of its own, which is suspended: roscpp would wait for it for ever."""

    def client(self, service: str, service_class) -> ServiceClient:
        client = ServiceClient(self.master, service, service_class, persistent=True)
        self.addCleanup(client.close)
        return client

    def setUp(self):
        super().setUp()
        port = free_port()
        uri = f"http://localhost:{port}"
        self.core = self.enter(Running("rosmaster", "--core", "-p", port))
        self.master = Master("/tests", uri)
        manager = self.run_process("env", f"ROS_MASTER_URI={uri}", *OURS, "__name:=cut_off")
        load = self.client("/cut_off/load_nodelet", NodeletLoad)

        def is_loaded(name: str) -> bool:
            try:
                load.call(5.0 * BUSY, name=name, type="dyknow_cpp_test/Source")
            except (HostError, errors.PeerTimeout):
                return False
            return True

        self.moves = []
        for name in ("/source", "/second", "/third", "/fourth"):
            eventually(
                lambda n=name: is_loaded(n), 20.0, f"{name} is loaded", lambda: manager.output
            )
            move = self.client(f"{name}/set_config", SetConfig)
            self.assertTrue(move.call(5.0 * BUSY, [PortConfig("out", "/a")]).success)
            self.moves.append(move)

    def test_polls_are_answered_while_many_set_config_wait(self):
        """Else leases would run out, and claims that nothing is wrong with fall silent."""
        client = PollClient(Master("/dyknow_manager", self.master.uri), "/cut_off", False)
        ports = self.client("/source/get_config", GetConfig)
        self.enter(contextlib.closing(client)).ask(5.0 * BUSY)
        ports.call(5.0 * BUSY)  # which finds it, as long as the ROS master answers

        def are_busy() -> bool:
            """Whether all threads that serve other services wait for the ROS master."""
            try:
                ports.call(1.0)
            except errors.PeerTimeout:
                return True
            return False

        def is_answered() -> bool:
            """Whether a poll is, before the first of them gives up."""
            movers = [
                threading.Thread(target=move.call, args=(20.0 * BUSY, [PortConfig("out", "/b")]))
                for move in self.moves
            ]
            for each in movers:
                each.start()
            eventually(are_busy, 2.0, "they wait")
            client.ask(20.0 * BUSY)
            is_first = all(each.is_alive() for each in movers)
            for each in movers:
                each.join()
            return is_first

        with suspended(self.core.pid):
            eventually(is_answered, 20.0, "polls do not wait with them")

    def test_set_config_is_refused_in_time(self):
        move = self.moves[0]
        ports = self.client("/source/get_config", GetConfig)
        ports.call(5.0 * BUSY)
        with suspended(self.core.pid):
            for _ in range(2):
                answer = move.call(5.0 * BUSY, [PortConfig("out", "/b")])
                self.assertFalse(answer.success)
                self.assertRegex(answer.message, "ROS master at .* does not answer")
            self.assertEqual(ports.call(5.0 * BUSY).ports[0].topic, "/a")
        self.assertTrue(move.call(5.0 * BUSY, [PortConfig("out", "/b")]).success)


class StuckTest(TellingCase):
    def test_a_callback_that_does_not_return_is_announced(self):
        self.parameter("/stuck/stuck_after", 1.0)
        manager = CppManager("/stuck")
        self.addCleanup(manager.__exit__)
        details: dict[str, list[str]] = {"/sink": [], "/source": []}

        def note(message: NodeletChanges) -> None:
            for each in message.nodelets:
                details[each.nodelet].append(each.detail)

        subscriber = rospy.Subscriber(NODES_TOPIC, NodeletChanges, note)
        self.addCleanup(subscriber.unregister)
        manager.load("Sink", "/sink", {"/in": "/a"}, delay=5.0)
        manager.load("Source", "/source", {"/out": "/a"}, count=1)
        eventually(lambda: all(details.values()), 5.0, "both are told")
        start("/source")
        eventually(lambda: any(details["/sink"]), 10.0, "the callback is told")
        self.assertRegex(max(details["/sink"]), "^a callback has been running for [0-9]+ s$")
        eventually(lambda: not details["/sink"][-1], 20.0, "its end is told")
        self.assertFalse(any(details["/source"]))

    def test_a_callback_may_run_for_ever(self):
        """What the process does later is done all the same."""
        manager = self.enter(CppManager("/patient", *OURS, "_stuck_after:=inf"))
        manager.load("Sink", "/sink", {"/in": "/a"})
        self.addCleanup(manager.unload_all)
        connect("/sink", **{"in": "/b"})
        becomes(lambda: graph.nodes_on("/a")[1], set())


class UnloadTest(CppCase):
    """A nodelet that is unloaded while its ports move."""

    def test_a_callback_that_outlives_the_unload(self):
        """The nodelet is destroyed at its end, when the loader has let go of its queues.

        However long that takes, its handles have them, and a nodelet that is loaded under its name
        meanwhile keeps the services that both have.
        """
        self.load("Sink", "in", "/a", mt=True, delay=0.5, last_delay=1.5)
        self.load("Source", "out", "/a", count=1)
        start("/source")
        becomes(lambda: report("/sink")["received"], 1)  # the callback runs
        self.manager.unload("/sink")
        self.load("Sink", "in", "/a", delay=0.0, last_delay=0.0)
        self.manager.wait_for("/sink is destroyed\n")
        self.assertEqual(report("/sink")["received"], 0)
        self.assertEqual(sorted(self.manager.list()), ["/sink", "/source"])

    def test_a_handle_that_is_made_after_the_unload(self):
        """It becomes a port of neither the process nor the nodelet that has the name by then."""
        self.load("Sink", "in", "/a", "/adding", mt=True, delay=0.5, adds=True)
        self.load("Source", "out", "/a", count=1)
        start("/source")
        becomes(lambda: report("/adding")["received"], 1)  # the callback runs
        self.manager.unload("/adding")
        self.load("Sink", "in", "/b", "/adding")
        self.manager.wait_for("/adding is destroyed\n")
        self.assertEqual(topics_of_ports("/adding"), {"in": "/b"})
        self.assertNotIn(f"{MANAGER}/get_config", graph.services_of(MANAGER))

    def test_a_service_that_unloads_its_nodelet(self):
        """It is answered, as in a stock nodelet manager."""
        self.load("Sink", "in", "/a", "/leaving", leaves=True)
        client = ServiceClient(Master("/tests"), "/leaving/report", Trigger)
        self.assertTrue(client.call(5.0 * BUSY).success)
        self.assertEqual(self.manager.list(), [])
        self.manager.wait_for("/leaving is destroyed\n")


if __name__ == "__main__":
    run()
