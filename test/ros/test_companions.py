#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Libraries for rospy nodes, used in nodelets: filters, tf2, diagnostics, parameters."""

from __future__ import annotations

import dynamic_reconfigure.client
import graph  # first: it makes the test package known
import rospy
import rostest
import tf2_ros
from actionlib.msg import TestActionGoal, TestGoal
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from graph import NodeletManagerCase, call
from processes import eventually
from sensor_msgs.msg import Image


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

    def test_between_nodelets_of_one_manager(self):
        for number in range(3):
            call("/one", "send", "map", "robot", float(number))
            eventually(
                lambda number=number: call("/two", "look_up", "map", "robot", 1.0) == number,
                5.0,
                "the transform",
            )

    def test_static_transforms(self):
        call("/one", "send_static", "robot", "camera", 4.0)
        self.assertEqual(call("/two", "look_up", "robot", "camera", 5.0), 4.0)
        self.manager.load("Frames", "/late")
        self.assertEqual(call("/late", "look_up", "robot", "camera", 5.0), 4.0)

    def test_from_a_nodelet_that_publishes_through_the_bus(self):
        """Ordinary broadcasters and listeners of the process share the topics with it."""
        self.manager.load("FramesByBus", "/bus")
        for sender, x in (("/bus", 1.0), ("/one", 2.0), ("/bus", 3.0)):
            call(sender, "send", "map", "robot", x)
            for name in ("/one", "/two", "/bus"):
                eventually(
                    lambda name=name, x=x: call(name, "look_up", "map", "robot", 1.0) == x,
                    5.0,
                    f"{name} hears {sender}",
                )
        call("/bus", "send_static", "robot", "camera", 4.0)
        self.manager.load("Frames", "/late")
        for name in ("/one", "/late"):
            self.assertEqual(call(name, "look_up", "robot", "camera", 5.0), 4.0)

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
        call("/two", "send", "map", "robot", 1.0)
        eventually(lambda: call("/one", "look_up", "map", "robot", 1.0) == 1.0, 5.0, "new")
        self.manager.unload("/one")
        call("/two", "send", "map", "robot", 2.0)
        eventually(lambda: call("/two", "look_up", "map", "robot", 1.0) == 2.0, 5.0, "old")


class DiagnosticsTest(NodeletManagerCase):
    def test_an_updater(self):
        heard = []
        subscriber = rospy.Subscriber("/diagnostics", DiagnosticArray, heard.append)
        self.addCleanup(subscriber.unregister)
        self.manager.load("Diagnosed", "/n")
        eventually(
            lambda: any(s.message == "a little warm" for array in heard for s in array.status),
            5.0,
            "a report",
        )
        status = next(s for array in heard for s in array.status if s.message == "a little warm")
        self.assertEqual(status.hardware_id, "/n")
        self.assertEqual(status.values[0].value, "71")


class ReconfigureTest(NodeletManagerCase):
    def test_a_server_in_the_nodelets_namespace(self):
        rospy.set_param("/robot/n/gain", 2.5)
        self.manager.load("Reconfigurable", "/robot/n")
        self.assertEqual(call("/robot/n", "seen"), [[2.5, 3]])
        client = dynamic_reconfigure.client.Client("/robot/n", timeout=5.0)
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
    rospy.init_node("companions_test")
    rostest.rosrun("dyknow", "companions", "__main__")
