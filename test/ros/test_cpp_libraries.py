#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""C++ libraries on topics: image_transport, message_filters, tf2, timers, signals."""

from __future__ import annotations

import signal

import graph
import rospy
from cpp_suite import RUN, Camera, CppManager, report
from geometry_msgs.msg import TransformStamped
from graph import connect, topics_of_ports
from manager_suite import ManagerCase
from processes import BUSY, becomes, eventually, run
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from dyknow.cli.rewirable import LIBRARY

LIBRARIES = (*RUN, "dyknow", "dyknow_cpp_test_node")


class LibrariesCase:
    """Libraries on topics go with the ports: image_transport, message_filters, tf2, timers."""

    name = ""

    def test_libraries(self):
        name, cameras = self.name, {"/cam": 8, "/cam2": 16}
        for namespace, width in cameras.items():
            self.enter(Camera(namespace, width))
        topics = (
            *("/camera/image", "/camera/camera_info", "/out/image", "/out/camera_info"),
            *("/left", "/right", "/tf", "/tf_static"),
        )
        ports = {topic if "tf" in topic else topic[1:]: topic for topic in topics}
        becomes(lambda: {port: topics_of_ports(name).get(port) for port in ports}, ports)
        for namespace, width in cameras.items():
            connect(name, **{"camera/image": f"{namespace}/image_raw"})
            topic = f"{namespace}/camera_info"
            self.assertEqual(topics_of_ports(name)["camera/camera_info"], topic)
            becomes(lambda: report(name)["width"], width)
        connect(name, **{"out/image": "/shown/image"})
        for topic, kind in (("/shown/image", Image), ("/shown/camera_info", CameraInfo)):
            self.assertEqual(rospy.wait_for_message(topic, kind, 10.0 * BUSY).width, 16)
        connect(name, left="/cam/camera_info", right="/cam/camera_info")
        eventually(lambda: report(name)["pairs"] > 2, 10.0, "pairs are made")
        self.assertEqual(report(name)["transforms"], 0)
        publisher = self.publisher("/other/tf", TFMessage, latch=True)
        transform = TransformStamped(child_frame_id="base")
        transform.header.frame_id = "map"
        transform.header.stamp = rospy.Time.now()
        transform.transform.rotation.w = 1.0
        publisher.publish([transform])
        connect(name, **{"/tf": "/other/tf"})
        becomes(lambda: report(name)["transforms"], 1)
        before = report(name)["ticks"]
        eventually(lambda: report(name)["ticks"] > before, 5.0, "its timer goes on")


class NodeletLibrariesTest(LibrariesCase, ManagerCase):
    name = "/libraries"

    def setUp(self):
        self.enter(CppManager("/cpp_manager")).load("Libraries", "/libraries")

    def test_sim_time(self):
        rospy.set_param("/use_sim_time", True)
        try:
            manager = self.enter(CppManager("/simulated"))
        finally:
            rospy.delete_param("/use_sim_time")
        publisher = self.publisher("/clock", Clock)
        manager.load("Libraries", "/late")
        self.assertNotIn("/clock", topics_of_ports("/late"))
        eventually(lambda: publisher.get_num_connections() > 0, 5.0, "it listens to the clock")
        for seconds in (100.0, 101.0):
            publisher.publish(rospy.Time.from_sec(seconds))
        eventually(lambda: report("/late")["ticks"] > 0, 5.0, "the timer follows the clock")


class NodeLibrariesTest(LibrariesCase, ManagerCase):
    name = "/libraries"

    def setUp(self):
        self.run_process(*LIBRARIES)
        rospy.wait_for_service("/libraries/environment", 20.0 * BUSY)

    def test_children_do_not_get_the_library(self):
        environment = rospy.ServiceProxy("/libraries/environment", Trigger)().message
        self.assertIn("PATH=", environment)
        self.assertNotIn(LIBRARY, environment)

    def test_signals_do_what_they_do_to_any_node(self):
        for number, code in ((signal.SIGINT, 0), (signal.SIGTERM, -signal.SIGTERM)):
            with graph.Ended(*LIBRARIES, "__name:=ending") as process:
                rospy.wait_for_service("/ending/get_config", 20.0 * BUSY)
                process.stop(number)
                self.assertEqual(process.exit_code(5.0), code)
                if number == signal.SIGINT:
                    left = graph.registrations("/ending")
                    self.assertEqual((left["publishers"], left["subscribers"]), ([], []))


if __name__ == "__main__":
    run()
