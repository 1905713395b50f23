# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Subscribers of several publications of one process on one topic: how many messages they keep."""

from __future__ import annotations

import contextlib
import gc
import socket
import struct
import weakref
from types import SimpleNamespace
from typing import Any, Iterator

import genpy
import pytest
import rospy.topics
from clocks import PATIENCE, in_thread, join
from rospy.impl.tcpros_base import TCPROSTransport
from rospy.impl.tcpros_pubsub import TCPROSPub
from std_msgs.msg import String

from dyknow.nodelet.scheduler import ManualExecutor
from dyknow.nodelet.streams.endpoints import Publication
from dyknow.ros.transport import intraprocess, topics
from dyknow.ros.transport.conversions import TypedReceiver
from dyknow.ros.transport.intraprocess import OrdinaryHandles
from dyknow.ros.transport.late_subscribers import LONGEST, LateSubscribers
from dyknow.ros.transport.outbound import Outbound
from dyknow.ros.transport.topics import RospyPublisher

#: Far more than sockets hold together.
COUNT, SIZE = 20, 400_000


class Topic:
    """One topic of this process: rospy's own publisher, with a master that does nothing."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.implementation = rospy.topics._PublisherImpl("/t", String)
        self.executor = ManualExecutor()
        outbound = lambda each, size: Outbound(each, size, None)  # noqa: E731
        self.handles = OrdinaryHandles("/t", "http://here", str, self.executor, outbound, set)
        self.sockets: list[socket.socket] = []
        self.notified: frozenset[str] = frozenset()
        fake: Any = SimpleNamespace(Publisher=self._registered, resolve_name=str)
        monkeypatch.setattr(topics, "rospy", fake)

    def _registered(self, *arguments: Any, queue_size: int, **options: Any) -> Any:
        self.implementation.set_queue_size(queue_size)
        self.implementation.is_latch |= options["latch"]
        self.implementation.ref_count += 1
        return SimpleNamespace(impl=self.implementation, unregister=self._unregister)

    def _unregister(self) -> None:
        self.implementation.ref_count -= 1

    def advertise(self, queue_size: int, latch: bool = False) -> RospyPublisher:
        intraprocess: Any = SimpleNamespace(publishing=lambda topic: self.handles, retire=str)
        subscribers = lambda topic: self.notified  # noqa: E731
        registrar: Any = SimpleNamespace(subscribers=subscribers, late=LateSubscribers())
        memory: Any = SimpleNamespace(publish=lambda *arguments: False)
        return RospyPublisher(intraprocess, memory, registrar, "/t", String, latch, queue_size, {})

    def ordinary(self) -> Any:
        """Make an ordinary publisher that latches."""
        self._registered(queue_size=1, latch=True)
        return self.implementation

    def subscribe(self, node: str = "/recorder", is_gone: bool = False) -> socket.socket:
        """Let a process subscribe, which may have ended just now; returns its socket."""
        here, there = socket.socketpair()
        there.settimeout(PATIENCE)
        if is_gone:
            there.close()
        self.sockets += [here, there]
        connection = TCPROSTransport(TCPROSPub("/t", String), "/t")
        connection.set_socket(here, node)
        self.implementation.add_connection(connection)
        return there

    def sizes(self) -> list[int]:
        return [each._queue_size for each in self.implementation.connections]


@pytest.fixture(name="topic")
def _topic(monkeypatch: pytest.MonkeyPatch) -> Iterator[Topic]:
    topic = Topic(monkeypatch)
    yield topic
    topic.implementation.close()  # else the garbage collector does, in any thread
    for each in topic.sockets:
        each.close()


def publish(publisher: RospyPublisher, size: int = 0) -> None:
    """Publish messages that begin with their numbers."""
    for number in range(COUNT):
        publisher.publish(String(f"{number} {'x' * size}"))


def received(there: socket.socket) -> list[int]:
    """Read until the last message has come; returns the numbers of all that came."""
    data, numbers = b"", [-1]
    while numbers[-1] < COUNT - 1:
        data += there.recv(1 << 20)
        while len(data) > 4 and len(data) >= 4 + struct.unpack_from("<I", data)[0]:
            (length,) = struct.unpack_from("<I", data)
            numbers.append(int(String().deserialize(data[4 : 4 + length]).data.split()[0]))
            data = data[4 + length :]
    return numbers[1:]


def test_a_subscriber_of_a_nodelet_that_is_yet_to_be_loaded_has_the_queue_of_the_nodelet(topic):
    topic.advertise(1)  # as for a nodelet that moves here
    there = topic.subscribe()
    loaded = topic.advertise(100)
    publish(loaded, SIZE)
    assert received(there) == list(range(COUNT))


def test_messages_for_a_late_subscriber_of_such_a_nodelet_are_kept_too(topic):
    topic.notified = frozenset(("/late",))
    topic.advertise(1).wait(0.0)
    topic.notified = frozenset()
    loaded = topic.advertise(5)
    publish(loaded)
    assert received(topic.subscribe("/late")) == list(range(COUNT - 5, COUNT))


@pytest.mark.parametrize("is_latching", [False, True], ids=["beside it", "of it"])
def test_a_late_subscriber_of_a_latching_publication_gets_what_it_missed_once(topic, is_latching):
    topic.notified = frozenset(("/late",))
    latching = topic.advertise(COUNT, latch=True)
    latching.wait(0.0)
    topic.notified = frozenset()
    send = latching.latch if is_latching else topic.advertise(COUNT).publish
    latching.latch(String("0 as of a port that moves"))
    for number in range(1, COUNT - 1):
        send(String(str(number)))
    there = topic.subscribe("/late")
    latching.latch(String(f"{COUNT - 1} as the last one"))
    assert received(there) == list(range(COUNT))
    assert received(topic.subscribe("/later")) == [COUNT - 1]


@pytest.mark.parametrize("is_bad", [False, True])
def test_what_a_late_subscriber_missed_is_not_latched_in_place_of_what_is(topic, is_bad):
    topic.notified = frozenset(("/late",))
    publisher = topic.advertise(COUNT)
    publisher.wait(0.0)
    publisher.publish(String(0 if is_bad else "0"))
    topic.ordinary().publish(String(f"{COUNT - 1} of an ordinary publisher"))
    with pytest.raises(genpy.SerializationError) if is_bad else contextlib.nullcontext():
        topic.subscribe("/late")
    assert topic.implementation.latch.data.endswith("of an ordinary publisher")


@pytest.mark.parametrize(
    ("queue_sizes", "expected"),
    [((1, 100), 100), ((100, 1), 100), ((0, 5), 0), ((5, 0), 0), ((3, 3), 3)],
)
def test_no_publication_narrows_the_queues_of_another_one(topic, queue_sizes, expected):
    for size in queue_sizes:
        topic.advertise(size)
        topic.subscribe(f"/{size}_{len(topic.sockets)}")
    assert topic.sizes() == [expected] * 2
    topic.subscribe("/later")
    assert topic.sizes() == [expected] * 3


def test_a_publication_that_comes_while_a_subscriber_connects(topic):
    topic.advertise(1)
    add = topic.handles._outbound

    def outbound(connection, size):
        topic.implementation.set_queue_size(7)  # rospy's, without a lock
        return add(connection, size)

    topic.handles._outbound = outbound
    topic.subscribe()
    topic.handles.widen(7)
    assert topic.sizes() == [7]
    topic.subscribe("/later")
    assert topic.sizes() == [7, 7]


def test_a_subscriber_that_can_be_seen_is_heard(topic):
    """Even if dead subscribers are forgotten at the moment in which it connects."""
    publisher = topic.advertise(1)
    add, heard = topic.handles._outbound, []

    def outbound(connection, size):
        topic.handles.forget_dead(lambda address: True)  # of another thread
        heard.append(publisher.heard)
        return add(connection, size)

    topic.handles._outbound = outbound
    assert not publisher.heard
    topic.subscribe()
    assert heard == [True]
    topic.implementation.remove_connection(topic.implementation.connections[0])
    assert not publisher.heard


def test_a_subscriber_whose_connection_fails_is_not_heard(topic):
    publisher = topic.advertise(1)
    topic.handles.expect(("/late",))

    def fail(endpoint):
        raise OSError("no address")

    topic.handles._address = fail
    with pytest.raises(OSError):
        topic.subscribe()
    topic.handles.forget_dead(lambda address: True)
    assert not publisher.heard


@pytest.mark.parametrize("has_other", [True, False])
def test_what_a_subscriber_missed_that_dies_while_it_connects_goes_to_no_other(topic, has_other):
    publisher = topic.advertise(100)
    others = [topic.subscribe("/other")] if has_other else []
    topic.handles.expect({"/late"})
    publish(publisher)
    topic.subscribe("/late", is_gone=True)
    assert len(topic.implementation.connections) == len(others)
    for there in others:
        assert received(there) == list(range(COUNT))
        there.settimeout(0.0)
        with pytest.raises(BlockingIOError):
            there.recv(1)


def test_a_publication_is_not_heard_by_a_subscriber_that_has_not_come_in_time(topic):
    publisher, now = topic.advertise(1), [100.0]
    topic.handles.backlog._clock = lambda: now[0]
    topic.handles.expect({"/late"})
    assert publisher.heard
    now[0] += LONGEST
    topic.handles.backlog.keep(String())
    assert not publisher.heard


@pytest.mark.parametrize("is_publishing", [True, False])
def test_a_wait_for_a_publisher_that_is_closed_meanwhile_ends(topic, is_publishing):
    """As where a nodelet is unloaded of which two threads publish."""
    publisher, lock = topic.advertise(1), topic.implementation.publock
    topic.subscribe()

    class Closing(String):
        def serialize(self, buff):
            publisher._closed = True
            topic.implementation.close()
            super().serialize(buff)

    def hold():
        with topic.handles._publisher_held():
            topic.implementation.close()

    join(in_thread((lambda: publisher.publish(Closing())) if is_publishing else hold))
    assert lock.acquire(blocking=False)


# Ordinary subscribers in the process itself


@pytest.fixture(name="subscriber")
def _subscriber(topic: Topic) -> Iterator[Any]:
    topic.advertise(3)
    subscriber = rospy.topics._SubscriberImpl("/t", String)
    topic.handles.link(subscriber)
    yield subscriber
    subscriber.close()


def deliver(topic: Topic, *texts: str) -> None:
    for text in texts:
        topic.handles.deliver(String(text))


@pytest.mark.parametrize(
    ("own", "published", "kept"),
    [(2, 3, "gh"), (4, 3, "efgh"), (None, 6, "cdefgh"), (None, 3, "defgh"), (None, 0, "abcdefgh")],
)
def test_an_ordinary_subscriber_keeps_the_newest_messages_of_its_queue(
    topic, subscriber, monkeypatch, own, published, kept
):
    monkeypatch.setattr(intraprocess, "_IN_SOCKETS", 5)
    topic.handles.widen(published)
    subscriber.set_queue_size(own)
    received = []
    for name in ("one", "other"):
        subscriber.add_callback(lambda message, name: received.append((name, message.data)), name)
    deliver(topic, *"abcdefgh")
    assert received == []
    topic.executor.drain()
    for name in ("one", "other"):
        assert "".join(text for each, text in received if each == name) == kept
    del received[:]
    deliver(topic, "i")
    topic.executor.drain()
    assert received == [("one", "i"), ("other", "i")]


def test_a_callback_is_not_called_any_more_once_it_is_removed(topic, subscriber):
    received = []
    callbacks = [lambda message: received.append(message.data) for _ in range(2)]
    for callback in callbacks:
        subscriber.add_callback(callback, None)
    deliver(topic, "a", "b")
    topic.executor.step()
    subscriber.remove_callback(callbacks[0], None)
    topic.executor.drain()
    assert received == ["a", "a", "b"]
    forgotten = weakref.ref(callbacks.pop(0))
    del callback
    gc.collect()
    assert forgotten() is None
    subscriber.close()
    deliver(topic, "c")
    topic.executor.drain()
    assert received == ["a", "a", "b"]


def test_an_ordinary_subscriber_gets_the_latched_message_once(topic, subscriber):
    received = []
    topic.handles.latch(object(), String("latched"))
    subscriber.add_callback(lambda message: received.append(message.data), None)
    topic.executor.drain()
    assert received == ["latched"]


@pytest.mark.parametrize("is_newest", [False, True])
def test_the_latched_message_of_an_ordinary_publisher_goes_with_it(topic, subscriber, is_newest):
    def come() -> list[str]:
        """Messages for a new port in here, a new ordinary subscriber, and a new process."""
        port: list[Any] = []
        ordinary: list[Any] = []
        subscriber.add_callback(TypedReceiver("/t", String, port.append).push, None)
        subscriber.add_callback(ordinary.append, None)
        topic.executor.drain()
        with contextlib.closing(topic.subscribe()) as there:
            there.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                return [each.data for each in (*port, *ordinary, String(there.recv(99)[8:]))]
        return [each.data for each in (*port, *ordinary)]

    published = topic.advertise(1, latch=True)
    send = [
        lambda: published.latch(String("bus")),
        lambda: topic.ordinary().publish(String("rospy")),
    ]
    for each in send if is_newest else reversed(send):
        each()
    newest = "rospy" if is_newest else "bus"
    assert come() == ["rospy", newest, newest.encode()], "a port gets that of the bus by the bus"
    topic._unregister()
    assert come() == ["bus", b"bus"]
    published.close()
    assert come() == []


def test_no_subscriber_gets_the_latched_message_of_a_fenced_publication(topic, subscriber):
    transport: Any = SimpleNamespace(build=None, converter=lambda datatype: None, sample_of=None)
    publication = Publication(String, True, 1, transport, float, KeyError, {}, "/n")
    is_allowed = [True]
    publication.connect("/t", topic.advertise(1, latch=True), (), lambda owner: is_allowed[0])
    publication.publish(String("before"))
    is_allowed[0] = False
    there, received = topic.subscribe(), []
    subscriber.add_callback(lambda message: received.append(message.data), None)
    is_allowed[0] = True
    publication.publish(String("after"))
    topic.executor.drain()
    assert received == ["after"]
    assert there.recv(100)[8:] == b"after", "behind two lengths"
