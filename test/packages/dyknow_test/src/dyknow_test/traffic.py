# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that publish, pass on and note messages."""

from __future__ import annotations

import collections
import threading
import time

import rospy
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from dyknow_test.puppet import Puppet


class CountedHeader(Header):
    """A Header that counts how often it is serialised."""

    serialisations = 0

    def serialize(self, buff):
        CountedHeader.serialisations += 1
        super().serialize(buff)


class Talker(Puppet):
    """Publishes numbered headers on the port `out`, on demand or by itself."""

    def set_up(self):
        self.out = self.nh.Publisher(
            "out",
            CountedHeader,
            queue_size=self.nh.get_param("~queue_size", 10),
            latch=self.nh.get_param("~latch", False),
        )
        self.sent = []
        self.stopped = threading.Event()
        self.thread = None

    def on_shutdown(self):
        self.stopped.set()
        super().on_shutdown()

    def publish(self, first, count):
        for number in range(first, first + count):
            message = CountedHeader(seq=number, frame_id=self.name)
            self.sent.append(message)
            self.out.publish(message)

    def start(self, rate):
        self.stopped.clear()
        self.thread = threading.Thread(target=self._talk, args=(1.0 / rate,), daemon=True)
        self.thread.start()

    def stop(self):
        """Stop publishing; returns the number of messages since `start`."""
        self.stopped.set()
        self.thread.join()
        return self.number

    def connections(self):
        return self.out.get_num_connections()

    def identities(self):
        return [id(message) for message in self.sent]

    def serialisations(self):
        return CountedHeader.serialisations

    def publish_nonsense(self):
        """Publish a message that cannot be serialised; returns the error."""
        try:
            self.out.publish(CountedHeader(frame_id=5))
        except rospy.ROSSerializationException as error:
            return f"rospy.ROSSerializationException: {error}"
        except Exception as error:
            return f"{type(error).__name__}: {error}"
        return ""

    def _talk(self, period):
        self.number = 0
        due = time.monotonic()
        while not self.stopped.wait(max(0.0, due - time.monotonic())):
            self.out.publish(CountedHeader(seq=self.number, frame_id=self.name))
            self.number += 1
            due += period


class Relay(Puppet):
    """Passes messages on from the port `in` to the port `out`."""

    def set_up(self):
        self.out = self.nh.Publisher("out", CountedHeader, queue_size=1000)
        self.sub = self.nh.Subscriber("in", CountedHeader, self.relay)
        self.passed = 0

    def relay(self, message):
        self.passed += 1
        self.out.publish(message)

    def count(self):
        return self.passed


class Lazy(Puppet):
    """Passes messages on from `in` to `out`, and subscribes only while `out` has a subscriber.

    With the parameter `~ports` false these are topics instead.
    """

    def set_up(self):
        self.events = []
        self.passed = 0
        self.sub = None
        self.handle = self.nh if self.nh.get_param("~ports", True) else self.node_handle
        self.out = self.handle.Publisher(
            "out",
            Header,
            subscriber_listener=self,
            latch=self.nh.get_param("~latch", False),
            queue_size=10,
        )

    def peer_subscribe(self, topic, publish, publish_to_peer):
        self.events.append(["subscribe", topic, self.out.get_num_connections()])
        publish_to_peer(Header(frame_id="welcome"))
        if self.sub is None:
            self.sub = self.handle.Subscriber("in", Header, self.relay)

    def peer_unsubscribe(self, topic, number):
        self.events.append(["unsubscribe", topic, number])
        if self.out.get_num_connections() == 0 and self.sub is not None:
            self.sub.unregister()
            self.sub = None

    def relay(self, message):
        self.passed += 1
        self.out.publish(message)

    def count(self):
        return self.passed

    def story(self):
        return self.events

    def connections(self):
        return self.out.get_num_connections()

    def is_listening(self):
        return self.sub is not None


class Listener(Puppet):
    """Notes the messages at the port `in`, and the reconfigurations between them."""

    def set_up(self):
        self.events = []
        self.messages = []
        self.sub = self.nh.Subscriber(
            "in", Header, self.note, queue_size=self.nh.get_param("~queue_size", 0)
        )
        self.nh.set_reconfigure_callback(self.reconfigured)

    def note(self, message):
        self.events.append(message.seq)
        self.messages.append(message)

    def reconfigured(self, inputs, outputs):
        self.events.append([inputs, outputs])

    def received(self):
        return [message.seq for message in self.messages]

    def count(self):
        return len(self.messages)

    def story(self):
        """Numbers and pairs of maps, in the order in which they came."""
        return self.events

    def senders(self):
        return collections.Counter(message.frame_id for message in self.messages)

    def identities(self):
        return [id(message) for message in self.messages]

    def connections(self):
        return self.sub.get_num_connections()


class Stamper(Puppet):
    """Publishes images with a header on `out`, and keeps them to show changes to their headers."""

    def set_up(self):
        self.out = self.nh.Publisher("out", Image, queue_size=10)
        self.sent = []

    def publish(self, count):
        for _ in range(count):
            message = Image()
            message.header.seq = 4711
            message.header.frame_id = None
            self.sent.append(message)
            self.out.publish(message)

    def headers(self):
        return [[message.header.seq, message.header.frame_id] for message in self.sent]


class ImageTalker(Puppet):
    """Publishes large images on `out`."""

    def set_up(self):
        self.out = self.nh.Publisher(
            "out", Image, queue_size=self.nh.get_param("~queue_size", 100)
        )

    def publish(self, count, size):
        """Publish and return how long that took, in s."""
        data = bytes(size)
        start = time.monotonic()
        for number in range(count):
            self.out.publish(Image(height=number, data=data))
        return time.monotonic() - start


class AnyListener(Puppet):
    """Notes messages of any type at the port `in`."""

    def set_up(self):
        self.numbers = []
        self.types = set()
        self.sub = self.nh.Subscriber("in", rospy.AnyMsg, self.note)

    def note(self, message):
        self.types.add(message._connection_header["type"])
        self.numbers.append(Header().deserialize(message._buff).seq)

    def received(self):
        return self.numbers

    def seen_types(self):
        return sorted(self.types)
