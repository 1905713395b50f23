# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that count, relay, fail, hang, crash and destroy themselves."""

from __future__ import annotations

import ctypes
import os
import time

import rospy
from dyknow_msgs.srv import Destroy
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Header, String

import dyknow


class Counter(dyknow.Nodelet):
    """Publishes headers at ~rate, numbered from the one after ~start."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.number = self.nh.get_param("~start", 0)
        self.out = self.nh.Publisher("out", Header, queue_size=1000)
        period = self.nh.Duration(1.0 / self.nh.get_param("~rate", 20.0))
        self.timer = self.nh.Timer(period, self.on_timer)

    def on_timer(self, event):
        self.number += 1
        self.out.publish(Header(seq=self.number, frame_id=str(self.number)))


class Relay(dyknow.Nodelet):
    """Publishes the messages that it receives."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.out = self.nh.Publisher("out", Header, queue_size=1000)
        self.input = self.nh.Subscriber("in", Header, self.out.publish, queue_size=1000)


class Busy(Relay):
    """Computes for ~work seconds of processor time before it publishes; ~start is that of on_init.

    Its messages name its process, too.
    """

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        time.sleep(self.nh.get_param("~start", 0.0))
        self.work = self.nh.get_param("~work", 0.004)
        self.out = self.nh.Publisher("out", Header, queue_size=1000)
        self.input = self.nh.Subscriber("in", Header, self.on_message, queue_size=1000)

    def on_message(self, message):
        end = time.thread_time() + self.work
        while time.thread_time() < end:
            pass
        self.out.publish(Header(frame_id=f"{message.frame_id} {rospy.get_name()}"))


class FailsInInit(Relay):
    """Raises after it has made all its handles."""

    def on_init(self):
        super().on_init()
        self.service = self.nh.Service("~left_over", Destroy, lambda request: None)
        raise RuntimeError("the camera is not plugged in")


class HangsInInit(Relay):
    """Does not return from on_init."""

    def on_init(self):
        super().on_init()
        time.sleep(1000.0)


class DestroysItself(dyknow.Nodelet):
    """Asks the manager to destroy it, from within the callback of its first message."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.input = self.nh.Subscriber("in", Header, self.on_message, queue_size=1)

    def on_message(self, message):
        self.nh.ServiceProxy("/dyknow_manager/destroy", Destroy)(self.name)


class Fatal(Relay):
    """Ends its process, in the way that ~on_init, ~on_message, ~on_shutdown or ~order names."""

    ways = {
        "abort": os.abort,
        "segfault": lambda: ctypes.string_at(0),
        "exit": lambda: os._exit(3),
        "shutdown": lambda: rospy.signal_shutdown("a nodelet wants it"),
    }

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.end_at("on_init")
        self.out = self.nh.Publisher("out", Header, queue_size=1000)
        self.input = self.nh.Subscriber("in", Header, self.on_message, queue_size=1000)
        self.order = self.private_node_handle.Subscriber("order", String, self.on_order)

    def on_order(self, message):
        self.ways[message.data]()

    def on_message(self, message):
        self.end_at("on_message")
        self.out.publish(message)

    def on_shutdown(self):
        self.end_at("on_shutdown")

    def end_at(self, moment):
        way = self.nh.get_param("~" + moment, "")
        if way:
            self.ways[way]()


class Moody(Relay):
    """Relays until the topic ~order says otherwise, and again when it says `work`.

    On `raise` its callback raises, on `silent` it publishes nothing, on `slow` it relays every
    twentieth message, and on `hang` its callback waits until the parameter /let_go is true.
    """

    def on_init(self):
        self.mood = "work"
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.out = self.nh.Publisher("out", Header, queue_size=1000)
        self.input = self.nh.Subscriber("in", Header, self.on_message, queue_size=1000)
        self.order = self.private_node_handle.Subscriber("order", String, self.on_order)

    def on_order(self, message):
        self.mood = message.data

    def on_message(self, message):
        if self.mood == "raise":
            raise RuntimeError("the lens is dirty")
        while self.mood == "hang" and not rospy.get_param("/let_go", False):
            time.sleep(0.05)
        if self.mood == "work" or (self.mood == "slow" and message.seq % 20 == 0):
            self.out.publish(message)


class Stamped(dyknow.Nodelet):
    """Publishes points that bear the present time, 20 times a second."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.out = self.nh.Publisher("out", PointStamped, queue_size=1000)
        self.timer = self.nh.Timer(self.nh.Duration(0.05), self.on_timer)

    def on_timer(self, event):
        self.out.publish(PointStamped(header=Header(stamp=self.nh.Time.now())))


class Lagging(dyknow.Nodelet):
    """Relays points; from when the topic ~order says `late` on, as if they were 10 s older."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.delay = 0.0
        self.out = self.nh.Publisher("out", PointStamped, queue_size=1000)
        self.input = self.nh.Subscriber("in", PointStamped, self.on_message, queue_size=1000)
        self.order = self.private_node_handle.Subscriber("order", String, self.on_order)

    def on_order(self, message):
        self.delay = 10.0 if message.data == "late" else 0.0

    def on_message(self, message):
        stamp = message.header.stamp - self.nh.Duration(self.delay)
        self.out.publish(PointStamped(header=Header(stamp=stamp)))


class Client(dyknow.Nodelet):
    """Acquires a stream from within a nodelet, and publishes its messages."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.out = self.nh.Publisher("out", Header, queue_size=1000)
        self.stream = dyknow.acquire(self.nh.get_param("~tag"), Header)
        self.input = self.node_handle.Subscriber(self.stream.topic, Header, self.out.publish)

    def on_shutdown(self):
        self.stream.release()
