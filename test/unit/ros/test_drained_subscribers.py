# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Subscribers that leave a topic outside: messages on the way, and subscribers that join."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from io import BytesIO
from types import SimpleNamespace
from typing import Any

import pytest
from clocks import PATIENCE, eventually, in_thread, join
from rospy.impl import tcpros_base
from rospy.impl.tcpros_pubsub import TCPROSSub
from std_msgs.msg import String

from dyknow.ros.transport import topics
from dyknow.ros.transport.topics import RospySubscriber

PUBLISHER = "http://publisher"


class Topic:
    """A topic with one publisher outside.

    Attributes:
        received: texts that came, with the name of the subscriber.
        again: addresses that were to be connected to again.
        connection: rospy's.
        publisher: the other end of it.
    """

    def __init__(self):
        self.received, self.again = [], []
        self._registrar: Any = SimpleNamespace(
            publishers=lambda topic: None,
            connect_again=lambda topic, uris: self.again.append(uris),
        )
        self._made = []

    def subscribe(self, name):
        """Make a subscriber, of which the first has the connection to the publisher."""
        made = RospySubscriber(self._registrar, "/drained", String, self._receive(name), {})
        self._made.append(made)
        if len(self._made) == 1:
            self._connect(made._implementation)
        return made

    def _receive(self, name):
        return lambda message: self.received.append((name, message.data))

    def _connect(self, implementation):
        protocol = TCPROSSub("/drained", String)
        self.connection = tcpros_base.TCPROSTransport(protocol, "/drained")
        here, self.publisher = socket.socketpair()
        self.connection.set_socket(here, PUBLISHER)
        implementation.add_connection(self.connection)
        callback = implementation.receive_callback
        self._thread = in_thread(lambda: self.connection.receive_loop(callback))

    def close(self):
        self.publisher.close()
        join(self._thread)
        for each in self._made:
            each.close()


@pytest.fixture
def topic(monkeypatch):
    monkeypatch.setattr(tcpros_base, "is_shutdown", lambda: False)
    made = Topic()
    yield made
    made.close()


def frame(text):
    body = BytesIO()
    String(text).serialize(body)
    return struct.pack("<I", body.tell()) + body.getvalue()


@pytest.mark.parametrize("names", [["one"], ["one", "other"]])
def test_a_message_that_has_come_in_part_is_received_before_the_topic_is_left(
    topic, monkeypatch, names
):
    leaving, *_ = map(topic.subscribe, names)
    sent = frame("whole" * 1000)
    topic.publisher.sendall(sent[:2000])
    eventually(lambda: topic.connection.read_buff.tell() == 2000)
    rest = [sent[2000:]]

    def sleep(seconds):
        while rest:
            with contextlib.suppress(OSError):
                topic.publisher.sendall(rest.pop())
        time.sleep(seconds)

    steady = SimpleNamespace(monotonic=time.monotonic, sleep=sleep)
    monkeypatch.setattr(topics, "time", steady)
    leaving.drain(PATIENCE)
    assert not rest
    if len(names) == 1:
        assert topic.connection.done
    else:
        eventually(lambda: len(topic.received) == 2)
    assert topic.received == [(name, "whole" * 1000) for name in names]


def test_the_next_message_of_each_publisher_is_awaited(topic, monkeypatch):
    leaving = topic.subscribe("one")
    queued = [frame("first") + frame("last")]
    asked = []

    def sleep(seconds):
        if queued:
            topic.publisher.sendall(queued.pop())
        time.sleep(seconds)

    monkeypatch.setattr(topics, "time", SimpleNamespace(monotonic=time.monotonic, sleep=sleep))
    leaving.hear(asked.append, 0.0)
    assert queued, "it waits for no time"
    leaving.hear(asked.append, PATIENCE)
    leaving.drain(PATIENCE)
    assert topic.received == [("one", "first"), ("one", "last")]
    leaving.hear(asked.append, PATIENCE)  # the connection has ended
    assert asked[:2] == [0.0, PATIENCE], "messages of this process count too"


def test_a_message_that_does_not_come_wholly_is_not_awaited_for_ever(topic):
    leaving = topic.subscribe("one")
    topic.publisher.sendall(frame("part")[:5])
    eventually(lambda: topic.connection.read_buff.tell() == 5)
    leaving.drain(0.0)
    eventually(lambda: topic.connection.done)
    assert topic.received == []


@pytest.mark.parametrize("joins", [False, True])
def test_who_joins_a_subscriber_that_leaves_is_connected_again(topic, joins):
    leaving = topic.subscribe("one")
    leaving.drain(PATIENCE)
    if joins:
        topic.subscribe("other")
    leaving.close()
    assert topic.again == ([{PUBLISHER}] if joins else [])
    leaving.close()
    assert len(topic.again) == joins


def test_a_subscriber_that_two_threads_close_leaves_a_joint_topic_once(topic, monkeypatch):
    leaving, other = map(topic.subscribe, ("one", "other"))
    manager = topics.get_topic_manager()
    release = manager.release_impl

    def release_amid_another_close(*arguments):
        monkeypatch.setattr(manager, "release_impl", release)
        leaving.close()
        release(*arguments)

    monkeypatch.setattr(manager, "release_impl", release_amid_another_close)
    leaving.close()
    assert not other._implementation.closed
