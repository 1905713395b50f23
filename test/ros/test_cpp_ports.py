#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Live ports of C++ nodelets that know nothing of them: moves, names, refusals, counts."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import statistics
import threading
import time

import graph
import rospy
import rostest
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
from dyknow_msgs.srv import GetConfig, GetCounts, SetConfig
from dynamic_reconfigure.msg import Config, DoubleParameter
from dynamic_reconfigure.srv import Reconfigure
from geometry_msgs.msg import Vector3
from graph import set_config, set_config_pairs, topics_of_ports
from nodelet.srv import NodeletLoad
from processes import BUSY, Running, TellingCase, eventually, free_port
from sensor_msgs.msg import Image
from std_msgs.msg import Float64, Header, String

from dyknow import errors
from dyknow.errors import HostError
from dyknow.guards import Guards
from dyknow.ros.nodelets.guard_parameters import guards_key, to_parameter
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient

RATE = 1000
#: Messages of one test; many in the long run.
COUNT = int(os.environ.get("DYKNOW_TEST_MESSAGES", RATE))
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

    def mover(self, nodelet: str, port: str) -> Mover:
        mover = Mover(nodelet, port)
        self.addCleanup(mover.close)
        return mover

    def assert_all_arrived(self, sink: str, count: int, timeout: float = 20.0) -> None:
        eventually(
            lambda: report(sink)["received"] >= count, timeout, "all arrived", lambda: report(sink)
        )
        self.assertEqual(flaws(sink), FLAWLESS)
        self.assertEqual(report(sink)["received"], count)


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
        self.assertGreater(len(times), COUNT / 200)

    def test_an_out_port(self):
        self.manager.load("Sink", "/sink", {"/in": "/a", "/second": "/b"}, second=True)
        self.manager.load("Source", "/source", {"/out": "/a"}, count=COUNT, rate=RATE)
        move = self.mover("/source", "out")
        self.moves_while_sending(COUNT, "/source", step=move)
        self.assert_all_arrived("/sink", COUNT)
        counts = graph.port_statistics("/source", "out")
        self.assertEqual((counts.messages, counts.dropped), (COUNT, 0))
        self.assertGreater(counts.rate, RATE / 10)

    def test_an_in_port_between_two_sources(self):
        for multithreaded in (False, True):
            with self.subTest(multithreaded=multithreaded):
                for source, topic in (("/left", "/a"), ("/right", "/b")):
                    self.manager.load("Source", source, {"/out": topic}, count=COUNT, rate=RATE)
                self.manager.load("Sink", "/sink", {"/in": "/a"}, mt=multithreaded)
                self.moves_while_sending(COUNT, "/left", "/right", step=self.mover("/sink", "in"))
                self.assertEqual(flaws("/sink"), FLAWLESS)
                self.assertGreater(report("/sink")["switches"], COUNT / 200)
                self.manager.unload_all()

    def test_both_ends_with_a_slow_receiver_that_has_a_backlog(self):
        count = 2 * COUNT  # each move waits for the receiver, so there are few of them a second
        self.manager.load("Sink", "/sink", {"/in": "/a"}, delay=0.002, queue_size=count)
        self.manager.load("Source", "/source", {"/out": "/a"}, count=count, rate=RATE)
        move_in, move_out = self.mover("/sink", "in"), self.mover("/source", "out")

        def move_both(topic: str) -> None:
            move_in(topic)
            move_out(topic)

        self.moves_while_sending(count, "/source", step=move_both)
        # Not from its report, which waits in its queue for all that came before.
        self.assertLess(graph.port_statistics("/sink", "in").messages, count)
        self.assert_all_arrived("/sink", count, 30.0)

    def test_a_disconnected_out_port_drops(self):
        self.manager.load("Sink", "/sink", {"/in": "/a"})
        self.manager.load("Source", "/source", {"/out": "/a"}, count=10, rate=RATE)
        self.mover("/source", "out")("")
        start("/source")
        eventually(lambda: report("/source")["sent"] == 10, 5.0, "all sent")
        counts = graph.port_statistics("/source", "out")
        self.assertEqual((counts.messages, counts.dropped, counts.topic), (0, 10, ""))
        self.assertEqual(report("/source")["listeners"], 0)
        self.assertEqual(report("/sink")["received"], 0)

    def test_a_latched_message_comes_with_every_connection(self):
        self.manager.load("Source", "/source", {"/out": "/a"}, latch=True)
        self.manager.load("Source", "/other", {"/out": "/b"})
        self.manager.load("Sink", "/sink", {"/in": "/b"})
        start("/source")
        eventually(lambda: report("/source")["sent"] == 1, 5.0, "sent")
        self.mover("/source", "out")("/b")  # a publisher and a listener of the process are there
        eventually(lambda: report("/sink")["received"] == 1, 5.0, "it came")
        counts = rospy.ServiceProxy(f"{MANAGER}/get_counts", GetCounts)(["/source"])
        self.assertTrue(counts.nodelets[0].ports[0].latched)

    def test_outside_subscribers_miss_nothing(self):
        heard = []
        for topic in ("/a", "/b"):
            subscriber = rospy.Subscriber(topic, Header, lambda message: heard.append(message.seq))
            self.addCleanup(subscriber.unregister)
        self.manager.load("Source", "/source", {"/out": "/a"}, count=800, rate=500)
        eventually(lambda: report("/source")["listeners"] == 1, 5.0, "connected")
        start("/source")
        move = self.mover("/source", "out")
        for topic in ("/b", "/a"):
            move(topic)
            time.sleep(0.3)  # as long as the old registration lingers
        eventually(lambda: len(heard) == 800, 10.0, "all heard", lambda: len(heard))
        self.assertEqual(sorted(heard), list(range(800)))


if COUNT > RATE:

    class PreloadedMoveTest(MoveTest):
        """In the stock nodelet manager, with the library preloaded."""

        command = PRELOADED


class PortTest(CppCase):
    """Ports as the services return them."""

    def test_names(self):
        self.manager.load(
            "Names",
            "/robot/names",
            {"/robot/words": "/said", "/robot/left": "/right", "/robot/resolved": "/found"},
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
                "loop_out": "/robot/loop",
                "loop_in": "/robot/loop",
                "text": "/robot/text",
                "point": "/robot/point",
            },
        )
        self.assertEqual(ports["loop_in"].direction, Port.IN)
        self.assertEqual(ports["text"].datatype, "std_msgs/String")
        answer = set_config("/robot/names", **{"/robot/words": "spoken", "~echo": "~inner"})
        self.assertTrue(answer.success, answer.message)
        topics = topics_of_ports("/robot/names")
        self.assertEqual(topics["words"], "/robot/spoken")
        self.assertEqual(topics["~echo"], "/robot/names/inner")
        self.assertIn("/robot/spoken", graph.registrations(MANAGER)["publishers"])

    def test_what_image_transport_adds_goes_with_the_image(self):
        self.manager.load("Names", "/names", {"/resolved": "/found"})
        for config, compressed in (
            ({"resolved": "/moved"}, "/moved/compressed"),
            ({"resolved": ""}, ""),
            ({"resolved": "/back"}, "/back/compressed"),
            ({"resolved": "/again", "resolved/compressed": "/own"}, "/own"),
            ({"resolved": "/further"}, "/own"),
        ):
            answer = set_config("/names", **config)
            self.assertTrue(answer.success, answer.message)
            topics = topics_of_ports("/names")
            self.assertEqual(topics["resolved"], config["resolved"])
            self.assertEqual(topics["resolved/compressed"], compressed)

    def test_a_port_to_come(self):
        """A lazy nodelet has no port yet, but the load names its topic."""
        self.manager.load("image_proc/resize", "/lazy", {"/image": "/lazy/disconnected/image"})
        self.assertNotIn("image", topics_of_ports("/lazy"))
        answer = set_config("/lazy", image="/cam/image_raw")
        self.assertTrue(answer.success, answer.message)
        self.assertEqual(topics_of_ports("/lazy")["image"], "/cam/image_raw")
        self.assertIn("unknown port 'imag'", set_config("/lazy", imag="/x").message)
        camera = Camera("/cam", 8)
        self.addCleanup(camera.close)
        self.assertEqual(width_on("/lazy/image"), 8)
        ports = {port.name: port for port in graph.get_config("/lazy")}
        self.assertEqual(ports["image"].datatype, "sensor_msgs/Image")

    def test_changes_are_announced_and_counted(self):
        told = []
        subscriber = rospy.Subscriber(
            f"{MANAGER}/changes", NodeletChanges, lambda message: told.extend(message.nodelets)
        )
        self.addCleanup(subscriber.unregister)
        eventually(lambda: graph.is_fed(f"{MANAGER}/changes"), 5.0, "connected")
        self.manager.load("Source", "/source", {"/out": "/a"}, count=7, rate=RATE)
        self.manager.load("Sink", "/later")  # its announcement comes after that of the other
        eventually(lambda: "/later" in told, 5.0, "loads are told")
        self.assertIn("/source", told)
        del told[:]
        set_config("/source", out="/b")
        eventually(lambda: "/source" in told, 5.0, "the change is told")
        del told[:]
        start("/source")
        ask = rospy.ServiceProxy(f"{MANAGER}/get_counts", GetCounts)
        eventually(lambda: ask(["/source"]).nodelets[0].ports[0].messages == 7, 5.0, "counted")
        self.manager.unload("/source")
        eventually(lambda: "/source" in told, 5.0, "the unload is told")
        self.assertEqual(ask(["/source"]).nodelets, [])
        self.assertEqual([each for each in graph.services_of(MANAGER) if "/source" in each], [])

    def test_a_lazy_nodelet(self):
        camera = Camera("/cam", 8), Camera("/cam2", 16)
        for each in camera:
            self.addCleanup(each.close)
        self.manager.load(
            "image_proc/crop_decimate",
            "/crop",
            {"/camera/image_raw": "/cam/image_raw", "/camera/camera_info": "/cam/camera_info"},
        )
        self.manager.load("image_proc/resize", "/resize", {"/image": "/camera_out/image_raw"})
        self.assertEqual(width_on("/resize/image"), 8)
        for camera_name, width in (("/cam2", 16), ("/cam", 8)):
            answer = set_config(
                "/crop",
                **{
                    "camera/image_raw": f"{camera_name}/image_raw",
                    "camera/camera_info": f"{camera_name}/camera_info",
                },
            )  # while it has no subscriber
            self.assertTrue(answer.success, answer.message)
            self.assertEqual(width_on("/resize/image"), width)
        eventually(lambda: not graph.nodes_on("/cam/image_raw")[1], 5.0, "nobody listens any more")

    def test_a_dynamic_reconfigure_server(self):
        camera = Camera("/cam", 8)
        self.addCleanup(camera.close)
        self.manager.load("image_proc/resize", "/resize", {"/image": "/cam/image_raw"})
        self.assertEqual(width_on("/resize/image"), 8)
        updates = "~parameter_updates"
        self.assertEqual(topics_of_ports("/resize")[updates], "/resize/parameter_updates")
        self.assertTrue(set_config("/resize", **{updates: "/elsewhere"}).success)
        told = []
        subscriber = rospy.Subscriber("/elsewhere", Config, told.append)
        self.addCleanup(subscriber.unregister)
        eventually(lambda: told, 5.0, "what it published last is told on the new topic")
        change = Config(doubles=[DoubleParameter("scale_width", 0.5)])
        rospy.ServiceProxy("/resize/set_parameters", Reconfigure)(change)
        eventually(lambda: width_on("/resize/image") == 4, 10.0, "its callback was called")
        scale = {each.name: each.value for each in told[-1].doubles}["scale_width"]
        self.assertEqual(scale, 0.5)


def width_on(topic: str) -> int:
    return rospy.wait_for_message(topic, Image, 20.0 * BUSY).width


class ReconfigureTest(CppCase):
    """The callback of nodelets that are written with dyknow/node_handle.h."""

    def means(self, topic: str, connected: bool = True) -> list[float]:
        """The numbers on a topic from now on, or once it is published."""
        found: list[float] = []
        subscriber = rospy.Subscriber(topic, Float64, lambda number: found.append(number.data))
        self.addCleanup(subscriber.unregister)
        eventually(lambda: not connected or graph.is_fed(topic), 5.0, "connected")
        return found

    def numbers(self, topic: str) -> rospy.Publisher:
        publisher = rospy.Publisher(topic, Float64, queue_size=10)
        self.addCleanup(publisher.unregister)
        return publisher

    def test_it_is_called_between_the_last_old_and_the_first_new_message(self):
        one, other = self.numbers("/one"), self.numbers("/other")
        self.manager.load("Smoother", "/smoother", {"/in": "/one"})
        means = self.means("/out")
        eventually(lambda: one.get_num_connections() > 0, 5.0, "connected")
        for number in (1.0, 3.0):
            one.publish(number)
        eventually(lambda: means == [1.0, 2.0], 5.0, "the mean of the one", lambda: means)
        self.mover("/smoother", "in")("/other")
        eventually(lambda: other.get_num_connections() > 0, 5.0, "connected")
        for number in (10.0, 20.0):
            other.publish(number)
        eventually(lambda: means[-2:] == [10.0, 15.0], 5.0, "it begins again", lambda: means)
        elsewhere = self.means("/elsewhere", connected=False)
        self.mover("/smoother", "out")("/elsewhere")
        other.publish(30.0)
        eventually(lambda: elsewhere == [30.0], 5.0, "it hears of its out-port too")

    def test_without_the_library_it_is_never_called(self):
        with CppManager("/stock", *STOCK) as stock:
            stock.load("Smoother", "/plain", {"/in": "/one", "/out": "/plain_out"})
            one = self.numbers("/one")
            means = self.means("/plain_out")
            eventually(lambda: one.get_num_connections() > 0, 5.0, "connected")
            one.publish(4.0)
            eventually(lambda: means == [4.0], 5.0, "it works", lambda: means)
            self.assertNotIn("/plain/set_config", graph.services_of("/stock"))


class RefusalTest(CppCase):
    """All or nothing, in the words of the Python proxy."""

    def setUp(self):
        self.manager.load("Source", "/n", {"/out": "/a"})

    def assert_refused(self, answer, *problems):
        self.assertEqual(answer.message, str(errors.InvalidConfiguration("/n", problems)))
        self.assertFalse(answer.success)
        self.assert_untouched()

    def assert_untouched(self):
        self.assertEqual(topics_of_ports("/n"), {"out": "/a"})
        self.assertEqual(graph.get_statistics("/n").reconfigurations, 0)

    def test_everything_at_once(self):
        self.assert_refused(
            set_config_pairs("/n", ("out", "/a//b"), ("lens", "/x"), ("out", "/y")),
            errors.DuplicatePort("out"),
            errors.InvalidName("/a//b", "topic name"),
            errors.UnknownPort("lens", ["out"]),
        )

    def test_a_topic_with_another_type(self):
        wanted = "std_msgs/Header (port 'out')"
        publisher = rospy.Publisher("/outside", String, queue_size=1)
        eventually(lambda: graph.nodes_on("/outside")[0], 5.0, "it is registered")
        self.assert_refused(
            set_config("/n", out="/outside"),
            errors.TypeMismatch("/outside", wanted, "std_msgs/String"),
        )
        publisher.unregister()
        self.manager.load("Names", "/names", {"/text": "/inside"})
        self.assert_refused(
            set_config("/n", out="/inside"),
            errors.TypeMismatch("/inside", wanted, "std_msgs/String"),
        )

    def test_a_topic_with_the_same_type_under_another_name(self):
        publisher = rospy.Publisher("/outside", Vector3, queue_size=1)
        self.addCleanup(publisher.unregister)
        eventually(lambda: graph.nodes_on("/outside")[0], 5.0, "it is registered")
        self.manager.load("Names", "/names")
        answer = set_config("/names", point="/outside")  # geometry_msgs/Point: equal checksums
        self.assertTrue(answer.success, answer.message)

    def test_the_type_of_a_publisher_that_is_gone_does_not_count(self):
        for topic, gone, present in (("/one", String, Header), ("/two", Header, String)):
            publisher = rospy.Publisher(topic, gone, queue_size=1)
            eventually(lambda t=topic: graph.nodes_on(t)[0], 5.0, "it is registered")
            publisher.unregister()
            subscriber = rospy.Subscriber(topic, present)
            self.addCleanup(subscriber.unregister)
            eventually(lambda t=topic: graph.nodes_on(t)[1], 5.0, "it is registered")
            eventually(lambda t=topic: not graph.nodes_on(t)[0], 5.0, "it is gone")
        self.assert_refused(
            set_config("/n", out="/two"),
            errors.TypeMismatch("/two", "std_msgs/Header (port 'out')", "std_msgs/String"),
        )
        answer = set_config("/n", out="/one")
        self.assertTrue(answer.success, answer.message)

    @contextlib.contextmanager
    def guarded(self, **guards):
        """Guards that hold for a while, of which one refuses strings of 21 characters."""
        parameter = f"{MANAGER}/{guards_key('/dyknow_manager')}"

        def hold() -> bool:
            return "unknown port" not in set_config("/n", **{21 * "x": "/x"}).message

        rospy.set_param(parameter, to_parameter(Guards(string_length=20, **guards)))
        try:
            eventually(hold, 5.0, "the guards hold")
            yield
        finally:
            rospy.delete_param(parameter)
            eventually(lambda: not hold(), 5.0, "the guards are lifted")

    def assert_said(self, answer, problem):
        self.assertEqual((answer.success, answer.message), (False, str(problem)))
        self.assert_untouched()

    def test_guards(self):
        topic = "/robot/left/wheel"
        why = "it matches '/robot/*' of the deny list (denied_topics)"
        with self.guarded(denied_topics=("/robot/*",), array_length=2):
            self.assert_refused(
                set_config("/n", out=topic), errors.Denied(f"topic '{topic}'", why)
            )
            self.assert_said(
                set_config("/n", out="/" + 20 * "ä"),
                errors.LimitExceeded("characters in a string", 21, 20),
            )
            self.assert_said(
                set_config_pairs("/n", ("a", "/a"), ("b", "/b"), ("c", "/c")),
                errors.LimitExceeded("entries in an array", 3, 2),
            )

    def test_read_only(self):
        why = "DyKnow runs read-only (parameter read_only)"
        with self.guarded(read_only=True):
            self.assert_said(
                set_config("/n", out="/x"), errors.Denied("connecting ports of '/n'", why)
            )


class HungMasterTest(TellingCase):
    """A ROS master of its own, which is suspended: roscpp would wait for it for ever."""

    def client(self, service: str, service_class) -> ServiceClient:
        client = ServiceClient(self.master, service, service_class, persistent=True)
        self.addCleanup(client.close)
        return client

    def test_set_config_is_refused_in_time(self):
        uri = f"http://localhost:{free_port()}"
        core = Running("rosmaster", "--core", "-p", uri.rpartition(":")[2])
        self.addCleanup(core.__exit__)
        self.master = Master("/tests", uri)
        environment = ("env", f"ROS_MASTER_URI={uri}")
        manager = graph.Ended(*environment, *OURS, "__name:=cut_off")
        self.addCleanup(manager.__exit__)
        load = self.client("/cut_off/load_nodelet", NodeletLoad)

        def is_loaded() -> bool:
            try:
                load.call(5.0, name="/source", type="dyknow_cpp_test/Source")
            except (HostError, errors.PeerTimeout):
                return False
            return True

        eventually(is_loaded, 20.0, "the nodelet is loaded", lambda: manager.output)
        set_config = self.client("/source/set_config", SetConfig)
        get_config = self.client("/source/get_config", GetConfig)
        self.assertTrue(set_config.call(5.0, [PortConfig("out", "/a")]).success)
        get_config.call(5.0)
        core.stop(signal.SIGSTOP)
        try:
            for _ in range(2):
                answer = set_config.call(5.0 * BUSY, [PortConfig("out", "/b")])
                self.assertFalse(answer.success)
                self.assertRegex(answer.message, "ROS master at .* does not answer")
            self.assertEqual(get_config.call(5.0).ports[0].topic, "/a")
        finally:
            core.stop(signal.SIGCONT)
        self.assertTrue(set_config.call(5.0 * BUSY, [PortConfig("out", "/b")]).success)


class UnloadTest(CppCase):
    """A nodelet that is unloaded while its ports move."""

    def test_a_callback_that_outlives_the_unload(self):
        """The nodelet is destroyed at its end, when the loader has let go of its queues.

        However long that takes, its handles have them.
        """
        self.manager.load("Sink", "/sink", {"/in": "/a"}, mt=True, delay=0.5, last_delay=1.5)
        self.manager.load("Source", "/source", {"/out": "/a"}, count=1)
        start("/source")
        eventually(lambda: report("/sink")["received"] == 1, 5.0, "the callback runs")
        self.manager.unload("/sink")

        def is_gone() -> bool:
            return "/sink/report" not in graph.services_of(MANAGER)

        eventually(lambda: is_gone() or self.manager.has_ended, 5.0, "it is destroyed")
        self.assertEqual(self.manager.list(), ["/source"])

    def test_unload_against_move(self):
        ended = threading.Event()
        refusals = []

        def move() -> None:
            topics = itertools.cycle(("/a", "/b", ""))
            while not ended.is_set():
                for nodelet, port in (("/source", "out"), ("/sink", "in")):
                    try:
                        answer = set_config(nodelet, **{port: next(topics)})
                        refusals.extend([answer.message] * (not answer.success))
                    except (rospy.ServiceException, rospy.ROSException):
                        pass  # it is unloaded just now

        threads = [threading.Thread(target=move) for _ in range(2)]
        for thread in threads:
            thread.start()
        try:
            for _ in range(max(5, COUNT // 400)):
                self.manager.load("Sink", "/sink", {"/in": "/a"})
                self.manager.load("Source", "/source", {"/out": "/a"}, count=COUNT, rate=RATE)
                start("/source")
                time.sleep(0.05)  # not a wait: the moves go on meanwhile
                self.manager.unload("/sink")
                self.manager.unload("/source")
        finally:
            ended.set()
            for thread in threads:
                thread.join()
        expected = ("was unloaded during", "is held up by another registration")
        others = [each for each in refusals if not any(text in each for text in expected)]
        self.assertEqual(others, [])
        self.assertEqual(self.manager.list(), [])
        eventually(lambda: not any(graph.nodes_on("/a")), 5.0, "nothing is left on the topic")


if __name__ == "__main__":
    rospy.init_node("cpp_ports_test")
    rostest.rosrun("dyknow", "cpp_ports", "__main__")
