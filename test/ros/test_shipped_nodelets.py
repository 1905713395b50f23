#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The shipped nodelets in a real nodelet manager, used by an ordinary node of another process."""

from __future__ import annotations

import queue
import sys

import rospy
import rostest
from dyknow_msgs.msg import Port, PortConfig
from dyknow_msgs.srv import GetConfig, GetStatistics, SetConfig
from graph import TIMEOUT, LaunchedManagerCase, service
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import Image
from std_msgs.msg import Header, String

SHIPPED = {
    "dyknow/Source": {("out", Port.OUT)},
    "dyknow/Relay": {("in", Port.IN), ("out", Port.OUT)},
    "dyknow/Throttle": {("in", Port.IN), ("out", Port.OUT)},
    "dyknow/Sink": {("in", Port.IN)},
}


class ShippedNodeletsTest(LaunchedManagerCase):
    def load(self, nodelet_type, ports=(), **parameters):
        """Load a nodelet with ports connected as in {port: topic}; returns its name."""
        name = f"/nodelet_{next(self.numbers)}"
        remappings = {f"/{port}": topic for port, topic in dict(ports).items()}
        self.manager.load(nodelet_type, name, remappings, **parameters)
        return name

    def listen(self, topic, datatype):
        """Subscribe as a node of another process; returns the queue that messages come to."""
        messages = queue.Queue()
        subscriber = rospy.Subscriber(topic, datatype, messages.put)
        self.addCleanup(subscriber.unregister)
        return messages

    def test_each_has_the_ports_that_its_docstring_states(self):
        for nodelet_type, expected in SHIPPED.items():
            for datatype in ("std_msgs/Header", "sensor_msgs/Image"):
                with self.subTest(type=nodelet_type, datatype=datatype):
                    name = self.load(nodelet_type, datatype=datatype)
                    ports = service(f"{name}/get_config", GetConfig)().ports
                    self.assertEqual({(port.name, port.direction) for port in ports}, expected)
                    self.assertEqual({port.datatype for port in ports}, {datatype})
                    self.assertEqual({port.topic for port in ports}, {""})

    def test_what_a_source_counts_in_frame_id_survives_rospys_own_numbers(self):
        messages = self.listen("/images", Image)
        self.load("dyknow/Source", {"out": "/images"}, rate=50, datatype="sensor_msgs/Image")
        counts = [int(image.header.frame_id) for image in self.take(messages, 10)]
        self.assertEqual(counts, list(range(counts[0], counts[0] + 10)))

    def test_a_chain_in_the_process_and_a_listener_outside(self):
        messages = self.listen("/relayed", Header)
        self.load("dyknow/Relay", {"in": "/raw", "out": "/relayed"})
        self.load("dyknow/Source", {"out": "/raw"}, rate=100)
        numbers = [each.seq for each in self.take(messages, 50)]
        self.assertEqual(numbers, list(range(numbers[0], numbers[0] + 50)))

    def test_a_relay_for_nodes_outside_alone(self):
        messages = self.listen("/text_out", String)
        name = self.load("dyknow/Relay", datatype="std_msgs/String")
        publisher = rospy.Publisher("/text_in", String, queue_size=10, latch=True)
        self.addCleanup(publisher.unregister)
        publisher.publish("through ports")
        answer = service(f"{name}/set_config", SetConfig)(
            [PortConfig("out", "/text_out"), PortConfig("in", "/text_in")]
        )
        self.assertTrue(answer.success, answer.message)
        self.assertEqual(self.take(messages, 1), [String("through ports")])

    def test_sink_logs(self):
        log = self.listen("/rosout", Log)
        name = self.load("dyknow/Sink", {"in": "/heard"}, period=0.5)
        self.load("dyknow/Source", {"out": "/heard"}, rate=20.0)
        while True:
            line = log.get(timeout=TIMEOUT).msg
            if line.startswith(f"{name}: ") and "latency" in line:
                break
        self.assertRegex(
            line, r"\d+ messages, \d+\.\d Hz, latency \d+\.\d{3} ms on average, \d+\.\d{3} ms"
        )
        port = service(f"{name}/get_statistics", GetStatistics)().ports[0]
        self.assertGreater(port.messages, 0)
        self.assertEqual(port.dropped, 0)


if __name__ == "__main__":
    rospy.init_node("test_shipped_nodelets")
    rostest.rosrun("dyknow", "shipped_nodelets", ShippedNodeletsTest, sys.argv)
