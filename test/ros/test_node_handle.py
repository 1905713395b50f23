#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""rospy's API, simulated time, and libraries built on them, in nodelets; shipped nodelets.

`unit/nodelet/test_handles.py` has the tests that need no ROS master.
"""

from __future__ import annotations

import threading

import dynamic_reconfigure.client
import graph  # first: it makes the test package known
import rospy
import tf2_ros
from actionlib.msg import TestActionGoal, TestGoal
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from graph import Heard, Manager, NodeletManagerCase, call, comes, is_linked
from processes import BUSY, becomes, eventually, run
from rosgraph_msgs.msg import Clock, Log
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage


class ApiTest(NodeletManagerCase):
    def setUp(self):
        self.manager.load("Features", "/robot/n", {"/robot/in": "/wired"}, answer=42)

    def do(self, method, *args):
        return call("/robot/n", method, *args)

    def test_names_of_parameters_resolve_from_the_nodelet(self):
        """Names of any characters are in use, such as the paper's `config-path`."""
        for name, key in (
            ("~own", "/robot/n/own"),
            ("shared", "/robot/shared"),
            ("/top", "/top"),
            ("~config-path", "/robot/n/config-path"),
            ("a b/c.d", "/robot/a b/c.d"),
            ("/1st/x/", "/1st/x"),
            ("~über", "/robot/n/über"),
        ):
            with self.subTest(name):
                rospy.set_param(key, "set outside")
                self.assertEqual(self.do("get_param", name), "set outside")
                self.do("set_param", name, [1, 2])
                self.assertEqual(rospy.get_param(key), [1, 2])
                self.assertTrue(self.do("has_param", name))
                found = self.do("search_param", name.strip("~/"))
                self.assertEqual(found, rospy.resolve_name(key))
                self.do("delete_param", name)
                self.assertFalse(rospy.has_param(key))

    def test_parameters_are_searched_upwards_and_outlive_the_nodelet(self):
        for key in ("/level", "/robot/level", "/robot/n/level"):
            rospy.set_param(key, "x")
            self.assertEqual(self.do("search_param", "level"), key)
        self.assertIsNone(self.do("search_param", "nowhere"))
        self.manager.unload("/robot/n")
        self.assertEqual(rospy.get_param("/robot/n"), {"answer": 42, "level": "x"})
        rospy.delete_param("/robot/n")

    def test_waits_for_messages(self):
        for method, name, topic in (
            ("wait_for_message", "in", "/wired"),
            ("wait_for_message_on_topic", "topic", "/robot/topic"),
        ):
            self.publisher(topic, Header, latch=True).publish(Header(seq=31))
            self.assertEqual(self.do(method, name, 5.0 * BUSY), 31)
            becomes(lambda topic=topic: graph.nodes_on(topic)[1], set())

    def test_waits_for_services(self):
        self.manager.load("Fragile", "/robot/server")
        self.assertEqual(self.do("echo_by_proxy", "server/obey", 5), 5)
        for wait in ("wait_for_service", "wait_by_proxy"):
            self.ends_with_the_nodelet(wait)
            self.manager.load("Features", "/robot/n")

    def ends_with_the_nodelet(self, wait):
        answers = []
        thread = threading.Thread(target=lambda: answers.append(self.do(wait, f"/{wait}")))
        thread.start()
        self.manager.wait_for(f"/robot/n waits for /{wait}")
        self.manager.unload("/robot/n")
        thread.join(5.0 * BUSY)
        self.assertEqual(answers, [f"service '/{wait}': nodelet /robot/n was unloaded"])

    def test_throttle_and_once_count_for_each_place_in_the_code(self):
        with Heard("/rosout", Log) as lines:
            self.do("log_often")
            plainly = lines.has(lambda line: "plainly logged" in line.msg)
        self.assertEqual(
            [line.msg for line in lines if line.level >= Log.WARN],
            [
                *("once here 0", "once there 0", "seldom here 0", "seldom there 0"),
                *("the same", "plainly logged"),
            ],
        )
        # The logged position is in the nodelet's code, not in DyKnow's.
        self.assertEqual(plainly.function, "Features.log_often")
        self.assertRegex(plainly.file, "features.py$")
        self.assertEqual(plainly.name, "/robot/n")
        self.assertIn("plainly logged", self.manager.output)


class ShippedTest(NodeletManagerCase):
    def test_a_chain_for_an_ordinary_node(self):
        """A Source's count in frame_id survives rospy's own numbers."""
        image = {"datatype": "sensor_msgs/Image"}
        self.manager.load("dyknow/Sink", "/sink", {"/in": "/relayed"}, period=0.5, **image)
        self.manager.load("dyknow/Relay", "/relay", {"/in": "/raw", "/out": "/relayed"}, **image)
        with Heard("/relayed", Image, lambda message: int(message.header.frame_id)) as counts:
            self.manager.load("dyknow/Source", "/source", {"/out": "/raw"}, rate=50, **image)
            counts.flows(30)
        self.assertEqual(list(counts), sorted(set(counts)))
        line = r"/sink: \d+ messages, \d+\.\d Hz, latency \d+\.\d{3} ms on average"
        self.manager.wait_for_match(line)


class FilterTest(NodeletManagerCase):
    def test_a_time_synchroniser_on_ports(self):
        self.manager.load("Synchroniser", "/n", {"/left": "/a", "/right": "/b"})
        publishers = {topic: self.publisher(topic, Image) for topic in ("/a", "/b", "/c")}

        def publish(*pairs):
            for topic, _ in pairs:
                eventually(publishers[topic].get_num_connections, 5.0, f"{topic} is connected")
            for topic, stamp in pairs:
                image = Image(height=stamp)
                image.header.stamp = rospy.Time(stamp)
                publishers[topic].publish(image)

        publish(("/a", 1), ("/a", 2), ("/b", 2), ("/b", 3), ("/a", 3))
        becomes(lambda: sorted(call("/n", "received")), [[2, 2], [3, 3]])
        graph.set_config("/n", right="/c")
        publish(("/a", 4), ("/c", 4))
        becomes(lambda: call("/n", "received")[-1], [4, 4])


class TransformTest(NodeletManagerCase):
    def setUp(self):
        for name in ("/one", "/two"):
            self.manager.load("Frames", name)

    def sent(self, sender, x, *receivers):
        """A transform reaches the receivers; rospy connects them once the master notifies it."""

        def look_up(name):
            call(sender, "send", "map", "robot", x)
            return call(name, "look_up", "map", "robot", 1.0)

        for name in receivers:
            becomes(lambda name=name: look_up(name), x)

    def test_between_nodelets_of_one_manager(self):
        """Ordinary broadcasters and listeners share the topics with publishers on the bus."""
        self.manager.load("FramesByBus", "/bus")
        for sender, x in (("/bus", 1.0), ("/one", 2.0), ("/bus", 3.0)):
            self.sent(sender, x, "/one", "/two", "/bus")
        for sender, child in (("/bus", "camera"), ("/one", "hand")):
            call(sender, "send_static", "robot", child, 4.0)
        self.manager.load("Frames", "/late")
        for name in ("/two", "/late"):
            for child in ("camera", "hand"):
                self.assertEqual(call(name, "look_up", "robot", child, 5.0 * BUSY), 4.0)

    def test_across_processes(self):
        buffer = tf2_ros.Buffer()
        listener = tf2_ros.TransformListener(buffer)
        self.addCleanup(listener.unregister)
        publisher = self.publisher("/tf", TFMessage)
        eventually(lambda: is_linked("/tf", 2), 5.0, "connected both ways")
        call("/one", "send", "map", "robot", 7.0)
        found = buffer.lookup_transform("map", "robot", rospy.Time(0), rospy.Duration(5.0 * BUSY))
        self.assertEqual(found.transform.translation.x, 7.0)
        transform = TransformStamped(child_frame_id="hand")
        transform.header.frame_id, transform.header.stamp = "robot", rospy.Time.now()
        transform.transform.rotation.w = 1.0
        transform.transform.translation.x = 2.0
        publisher.publish([transform])
        self.assertEqual(call("/two", "look_up", "robot", "hand", 5.0 * BUSY), 2.0)

    def test_an_unloaded_listener_leaves_the_others(self):
        self.manager.unload("/one")
        self.manager.load("Frames", "/one")
        self.sent("/two", 1.0, "/one")
        self.manager.unload("/one")
        self.sent("/two", 2.0, "/two")


class LibrariesTest(NodeletManagerCase):
    def test_diagnostics(self):
        self.manager.load("Diagnosed", "/n")

        def warm(array):
            return [each for each in array.status if each.message == "a little warm"]

        (status,) = warm(comes("/diagnostics", DiagnosticArray, warm))
        self.assertEqual(status.hardware_id, "/n")
        self.assertEqual(status.values[0].value, "71")

    def test_a_server_of_dynamic_reconfigure_in_the_nodelets_namespace(self):
        rospy.set_param("/robot/n/gain", 2.5)
        self.manager.load("Reconfigurable", "/robot/n")
        self.assertEqual(call("/robot/n", "seen"), [[2.5, 3]])
        client = dynamic_reconfigure.client.Client("/robot/n", timeout=5.0 * BUSY)
        self.addCleanup(client.close)
        self.assertEqual(client.update_configuration({"size": 7, "gain": 100.0})["gain"], 10.0)
        self.assertEqual(call("/robot/n", "seen")[-1], [10.0, 7])
        self.assertEqual(rospy.get_param("/robot/n/size"), 7)
        client.close()
        # The topics that the nodelet shut down itself are gone, and can be advertised again.
        self.manager.unload("/robot/n")
        self.nothing_is_left()
        self.manager.load("Reconfigurable", "/robot/n")
        self.assertEqual(call("/robot/n", "seen"), [[10.0, 7]])

    def test_they_act_in_the_name_of_their_nodelet(self):
        self.manager.load("Careless", "/robot/one")
        self.manager.load("Careless", "/robot/two")
        self.assertEqual(call("/robot/two", "ask", "/robot/one/count", 41), 42)
        self.assertEqual(call("/robot/one", "ask", "/robot/one/count", 1), 2)
        offered = graph.services_of("/manager")
        for name in ("/robot/one", "/robot/two"):
            self.assertIn(f"{name}/set_parameters", offered)
        self.assertEqual(rospy.get_param("/robot/two/size"), 3)

    def test_they_are_gone_with_it_and_come_back_without_a_word(self):
        """The nodelet itself takes nothing back."""
        goals = self.publisher("/n/count/goal", TestActionGoal)
        for number in range(3):
            self.manager.load("Careless", "/n")
            eventually(goals.get_num_connections, 5.0, "connected")
            goals.publish(TestActionGoal(goal=TestGoal(number)))
            becomes(lambda: rospy.get_param("/counted", -1), number)
            self.manager.unload("/n")
            self.nothing_is_left()
            becomes(goals.get_num_connections, 0)
        for word in ("WARN", "ERROR", "Traceback"):
            self.assertNotIn(word, self.manager.output)


class SimTimeTest(NodeletManagerCase):
    """Timers follow /clock, statistics and time limits do not."""

    manager_name = "/simulated"

    @classmethod
    def start_manager(cls):
        rospy.set_param("/use_sim_time", True)
        manager = Manager(cls.manager_name)
        cls.addClassCleanup(manager.__exit__)
        rospy.delete_param("/use_sim_time")
        return manager

    def setUp(self):
        self.clock = self.publisher("/clock", Clock, queue_size=1000)
        is_connected = lambda: "/simulated" in graph.nodes_on("/clock")[1]  # noqa: E731
        eventually(is_connected, 5.0, "it has a clock")
        for name in ("Metronome", "Features"):
            self.manager.load(name, f"/{name.lower()}")
        self.run_clock(100.0, 0.0)

    def run_clock(self, begin, seconds, step=0.01):
        """Let the clock run, much faster than a real one, until the manager has the time."""
        for number in range(round(seconds / step) + 1):
            self.now = round(begin + number * step, 3)
            self.clock.publish(Clock(rospy.Time.from_sec(self.now)))

        def is_known():
            self.clock.publish(Clock(rospy.Time.from_sec(self.now)))
            return [round(each, 3) for each in call("/features", "clock")] == [self.now] * 3

        eventually(is_known, 5.0, "the manager knows the time", lambda: call("/features", "clock"))

    def test_timers_follow_the_clock(self):
        call("/metronome", "start", 1.0)
        self.run_clock(100.0, 0.1)
        for number in range(10):  # the clock stands until it was called
            self.run_clock(100.1 + number, 1.0)
            becomes(lambda: call("/metronome", "count"), number + 1)
        for number, at in enumerate(call("/metronome", "times")):
            self.assertAlmostEqual(at, 101.0 + number, delta=0.2)
        # While the clock stands, nothing happens, even after a call that takes real time.
        call("/metronome", "start_once", 0.5)
        self.assertEqual(call("/metronome", "count_shots"), 0)
        self.run_clock(110.1, 0.8)
        becomes(lambda: call("/metronome", "count_shots"), 1)
        self.assertEqual(call("/metronome", "count"), 10)

    def test_sleep_follows_the_clock(self):
        answers = []
        thread = threading.Thread(target=lambda: answers.append(call("/features", "sleep", 1e3)))
        thread.start()
        self.manager.wait_for("/features sleeps")
        for begin in range(100, 3100, 1000):  # once is enough, unless it only begins to sleep
            self.run_clock(begin, 1000.0, step=10.0)
            thread.join(1.0 * BUSY)
        self.assertGreaterEqual(answers[0], 1e3)

    def test_ages_follow_the_clock(self):
        self.manager.load("dyknow_manager_test/Stamped", "/stamped", {"/out": "/points"})
        ages = []

        def measure():
            self.run_clock(100.0, 1.0)
            (counts,) = graph.poll("/simulated", "/stamped").counts
            ages.extend(port.age for port in counts.ports if port.age == port.age)
            return len(ages) >= 3

        eventually(measure, 10.0, "ages are measured")
        # Within the second that the clock runs over again and again, not decades of real time.
        self.assertLessEqual(max(map(abs, ages)), 1.01)

    def test_statistics_and_time_limits_do_not(self):
        uptime = graph.get_statistics("/metronome").uptime
        eventually(lambda: graph.get_statistics("/metronome").uptime > uptime, 5.0, "it goes on")
        # These would wait for ever: the clock stands.
        self.manager.load("Listener", "/listener")
        self.assertTrue(graph.set_config("/listener", **{"in": "/nobody"}).success)
        self.manager.unload("/listener")


if __name__ == "__main__":
    run()
