#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""rospy's API and the libraries built on it, in nodelets of a real manager; shipped nodelets.

`unit/nodelet/test_handles.py` has what needs no ROS master.
"""

from __future__ import annotations

import queue
import threading

import dynamic_reconfigure.client
import graph  # first: it makes the test package known
import rospy
import rostest
import tf2_ros
from actionlib.msg import TestActionGoal, TestGoal
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from graph import NodeletManagerCase, call, comes
from processes import BUSY, eventually
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import Image
from std_msgs.msg import Header


class ParameterTest(NodeletManagerCase):
    def setUp(self):
        self.manager.load("Features", "/robot/n", answer=42)

    def test_names_resolve_from_the_nodelet(self):
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
                self.assertEqual(call("/robot/n", "get_param", name), "set outside")
                call("/robot/n", "set_param", name, [1, 2])
                self.assertEqual(rospy.get_param(key), [1, 2])
                self.assertTrue(call("/robot/n", "has_param", name))
                found = call("/robot/n", "search_param", name.strip("~/"))
                self.assertEqual(found, rospy.resolve_name(key))
                call("/robot/n", "delete_param", name)
                self.assertFalse(rospy.has_param(key))

    def test_search_goes_upwards_from_the_nodelet(self):
        for key in ("/level", "/robot/level", "/robot/n/level"):
            rospy.set_param(key, "x")
            self.assertEqual(call("/robot/n", "search_param", "level"), key)
        self.assertIsNone(call("/robot/n", "search_param", "nowhere"))

    def test_they_outlive_the_nodelet(self):
        call("/robot/n", "set_param", "~own", 1)
        self.manager.unload("/robot/n")
        self.assertEqual(rospy.get_param("/robot/n"), {"answer": 42, "own": 1})
        rospy.delete_param("/robot/n")


class WaitTest(NodeletManagerCase):
    def setUp(self):
        self.manager.load("Features", "/n", {"/in": "/wired"})

    def test_for_messages(self):
        for method, name, topic in (
            ("wait_for_message", "in", "/wired"),
            ("wait_for_message_on_topic", "topic", "/topic"),
        ):
            publisher = rospy.Publisher(topic, Header, queue_size=10, latch=True)
            self.addCleanup(publisher.unregister)
            publisher.publish(Header(seq=31))
            self.assertEqual(call("/n", method, name, 5.0 * BUSY), 31)
            self.assertEqual(graph.nodes_on(topic)[1], set())

    def test_for_services(self):
        self.manager.load("Fragile", "/robot/server")
        self.assertEqual(call("/n", "echo_by_proxy", "robot/server/obey", 5), 5)
        answers = []
        thread = threading.Thread(
            target=lambda: answers.append(call("/n", "wait_for_service", "/nowhere"))
        )
        thread.start()
        eventually(lambda: "/n waits for /nowhere" in self.manager.output, 5.0, "it waits")
        self.manager.unload("/n")
        thread.join(5.0 * BUSY)
        self.assertEqual(answers, ["service '/nowhere': nodelet /n was unloaded"])


class LogTest(NodeletManagerCase):
    def test_throttle_and_once_count_for_each_place_in_the_code(self):
        lines = []
        subscriber = rospy.Subscriber("/rosout", Log, lines.append)
        self.addCleanup(subscriber.unregister)
        self.manager.load("Features", "/robot/n")
        eventually(lambda: any(line.name == "/manager" for line in lines), 5.0, "it is heard")
        call("/robot/n", "log_often")
        eventually(lambda: any("plainly logged" in line.msg for line in lines), 5.0, "logged")
        logged = [line.msg for line in lines if line.level >= Log.WARN]
        self.assertEqual(
            logged,
            [
                "once here 0",
                "once there 0",
                "seldom here 0",
                "seldom there 0",
                "the same",
                "plainly logged",
            ],
        )
        # The logged position is in the nodelet's code, not in DyKnow's.
        plainly = next(line for line in lines if "plainly" in line.msg)
        self.assertEqual(plainly.function, "Features.log_often")
        self.assertRegex(plainly.file, "features.py$")
        self.assertIn("plainly logged", self.manager.output)


class ShippedTest(NodeletManagerCase):
    def test_a_chain_for_an_ordinary_node(self):
        """What a Source counts in frame_id survives rospy's own numbers."""
        messages, log = queue.Queue(), queue.Queue()
        for topic, datatype, found in (("/relayed", Image, messages), ("/rosout", Log, log)):
            self.addCleanup(rospy.Subscriber(topic, datatype, found.put).unregister)
        image = {"datatype": "sensor_msgs/Image"}
        self.manager.load("dyknow/Sink", "/sink", {"/in": "/relayed"}, period=0.5, **image)
        self.manager.load("dyknow/Relay", "/relay", {"/in": "/raw", "/out": "/relayed"}, **image)
        self.manager.load("dyknow/Source", "/source", {"/out": "/raw"}, rate=50, **image)
        arrived = [messages.get(timeout=5.0 * BUSY) for _ in range(30)]
        counts = [int(each.header.frame_id) for each in arrived]
        self.assertEqual(counts, list(range(counts[0], counts[0] + 30)))
        line = ""
        while not line.startswith("/sink: ") or "latency" not in line:
            line = log.get(timeout=5.0 * BUSY).msg
        self.assertRegex(line, r"\d+ messages, \d+\.\d Hz, latency \d+\.\d{3} ms on average")


class FilterTest(NodeletManagerCase):
    def test_a_time_synchroniser_on_ports(self):
        self.manager.load("Synchroniser", "/n", {"/left": "/a", "/right": "/b"})
        publishers = {}
        for topic in ("/a", "/b", "/c"):
            publishers[topic] = rospy.Publisher(topic, Image, queue_size=10)
            self.addCleanup(publishers[topic].unregister)

        def publish(topic, stamp):
            image = Image(height=stamp)
            image.header.stamp = rospy.Time(stamp)
            publishers[topic].publish(image)

        for topic in ("/a", "/b"):
            eventually(publishers[topic].get_num_connections, 5.0, "connected")
        for topic, stamp in (("/a", 1), ("/a", 2), ("/b", 2), ("/b", 3), ("/a", 3)):
            publish(topic, stamp)
        eventually(lambda: sorted(call("/n", "received")) == [[2, 2], [3, 3]], 5.0, "two pairs")
        graph.set_config("/n", right="/c")
        publish("/a", 4)
        publish("/c", 4)
        eventually(lambda: call("/n", "received")[-1] == [4, 4], 5.0, "across the re-wiring")


class TransformTest(NodeletManagerCase):
    def setUp(self):
        for name in ("/one", "/two"):
            self.manager.load("Frames", name)

    def sent(self, sender, x, *receivers):
        """A transform reaches the receivers."""
        call(sender, "send", "map", "robot", x)
        for name in receivers:
            eventually(
                lambda name=name: call(name, "look_up", "map", "robot", 1.0) == x,
                5.0,
                f"{name} hears {sender}",
            )

    def test_between_nodelets_of_one_manager(self):
        """Ordinary broadcasters and listeners share the topics with what the bus publishes."""
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
        eventually(
            lambda: "/manager" in graph.nodes_on("/tf")[0]
            and listener.tf_sub.get_num_connections() > 0,
            5.0,
            "connected",
        )

        def heard():
            call("/one", "send", "map", "robot", 7.0)
            return buffer.can_transform("map", "robot", rospy.Time(0))

        eventually(heard, 5.0, "from the nodelet")
        broadcaster = tf2_ros.TransformBroadcaster()
        self.addCleanup(broadcaster.pub_tf.unregister)
        transform = TransformStamped()
        transform.header.frame_id, transform.child_frame_id = "robot", "hand"
        transform.transform.rotation.w = 1.0
        transform.transform.translation.x = 2.0

        def answered():
            transform.header.stamp = rospy.Time.now()
            broadcaster.sendTransform(transform)
            return call("/two", "look_up", "robot", "hand", 0.2) == 2.0

        eventually(answered, 5.0, "to the nodelet")

    def test_an_unloaded_listener_leaves_the_others(self):
        self.manager.unload("/one")
        self.manager.load("Frames", "/one")
        self.sent("/two", 1.0, "/one")
        self.manager.unload("/one")
        self.sent("/two", 2.0, "/two")


class DiagnosticsTest(NodeletManagerCase):
    def test_an_updater(self):
        self.manager.load("Diagnosed", "/n")

        def warm(array):
            return [each for each in array.status if each.message == "a little warm"]

        (status,) = warm(comes("/diagnostics", DiagnosticArray, warm))
        self.assertEqual(status.hardware_id, "/n")
        self.assertEqual(status.values[0].value, "71")


class ReconfigureTest(NodeletManagerCase):
    def test_a_server_in_the_nodelets_namespace(self):
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
        self.assertFalse(graph.nodes_on("/robot/n/parameter_updates")[0])
        self.manager.load("Reconfigurable", "/robot/n")
        self.assertEqual(call("/robot/n", "seen"), [[10.0, 7]])


class CarelessTest(NodeletManagerCase):
    """Things that nodelets leave to DyKnow to take back."""

    def test_libraries_act_in_the_name_of_their_nodelet(self):
        self.manager.load("Careless", "/robot/one")
        self.manager.load("Careless", "/robot/two")
        self.assertEqual(call("/robot/two", "ask", "/robot/one/count", 41), 42)
        self.assertEqual(call("/robot/one", "ask", "/robot/one/count", 1), 2)
        offered = graph.services_of("/manager")
        for name in ("/robot/one", "/robot/two"):
            self.assertIn(f"{name}/set_parameters", offered)
        self.assertEqual(rospy.get_param("/robot/two/size"), 3)

    def test_they_are_gone_with_it_and_come_back_without_a_word(self):
        before = graph.registrations("/manager")
        goals = rospy.Publisher("/n/count/goal", TestActionGoal, queue_size=10)
        self.addCleanup(goals.unregister)
        for number in range(3):
            self.manager.load("Careless", "/n")
            eventually(goals.get_num_connections, 5.0, "connected")
            goals.publish(TestActionGoal(goal=TestGoal(number)))
            eventually(lambda n=number: rospy.get_param("/counted", -1) == n, 5.0, "executed")
            self.manager.unload("/n")
            eventually(
                lambda: graph.registrations("/manager") == before,
                5.0,
                "nothing is left",
                lambda: graph.registrations("/manager"),
            )
            eventually(lambda: not goals.get_num_connections(), 5.0, "disconnected")
        for word in ("WARN", "ERROR", "Traceback"):
            self.assertNotIn(word, self.manager.output)


if __name__ == "__main__":
    rospy.init_node("node_handle_test")
    rostest.rosrun("dyknow", "node_handle", "__main__")
