# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A nodelet with ordinary handles of rospy beside those of the bus."""

from __future__ import annotations

import functools
import sys

import rospy
from std_msgs.msg import Header

from dyknow_test.puppet import Puppet


class Ordinary(Puppet):
    """Makes, uses and removes handles on one topic, of the bus and of rospy."""

    def set_up(self):
        self.handles = {}
        self.notes = {}
        self.headers = {}
        self.makers = {
            "bus": self.node_handle,
            "rospy": rospy,
        }

    def on_shutdown(self):
        for label in list(self.handles):
            self.remove(label)
        super().on_shutdown()

    def make_publisher(self, label, kind, topic, latch=False):
        self.handles[label] = self.makers[kind].Publisher(
            topic, Header, queue_size=10, latch=latch
        )

    def limit_nested_calls(self, limit):
        sys.setrecursionlimit(limit)

    def make_and_remove_publishers(self, count, kind, topic):
        for _ in range(count):
            self.makers[kind].Publisher(topic, Header, queue_size=10).unregister()

    def make_subscriber(self, label, kind, topic):
        self.notes[label] = []
        callback = functools.partial(self.note, label)
        self.handles[label] = self.makers[kind].Subscriber(topic, Header, callback)

    def note(self, label, message):
        self.notes[label].append(message.seq)
        self.headers[label] = getattr(message, "_connection_header", None)

    def remove(self, label):
        self.handles.pop(label).unregister()

    def publish(self, label, numbers):
        for number in numbers:
            self.handles[label].publish(Header(seq=number))

    def connections(self, label):
        return self.handles[label].get_num_connections()

    def make_any_subscriber(self, label, topic):
        self.notes[label] = []
        callback = functools.partial(self.note_any, label)
        self.handles[label] = rospy.Subscriber(topic, rospy.AnyMsg, callback)

    def note_any(self, label, message):
        header = Header().deserialize(message._buff)
        header._connection_header = message._connection_header
        self.note(label, header)

    def header(self, label):
        return self.headers[label]

    def received(self, label):
        return self.notes[label]
