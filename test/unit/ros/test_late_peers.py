# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Peers that connect late: how long they are waited for, messages kept for them, reminders."""

from __future__ import annotations

import logging
import socket
import threading
from types import SimpleNamespace
from typing import Any, Collection
from unittest import mock

import pytest
import rospy.core
import rospy.topics
from clocks import PATIENCE as DEADLINE
from clocks import eventually
from rospy.impl import registration, tcpros, tcpros_pubsub
from rospy.impl.tcpros_base import TCPROSTransport
from rospy.topics import _SubscriberImpl
from std_msgs.msg import Header

from dyknow.errors import PeerTimeout
from dyknow.nodelet.scheduler import ManualExecutor
from dyknow.ros.transport import topics
from dyknow.ros.transport.intraprocess import IntraProcess, OrdinaryHandles
from dyknow.ros.transport.late_subscribers import (
    LATELY,
    LONGEST,
    Backlog,
    LateSubscribers,
    Reminders,
)
from dyknow.ros.transport.outbound import Outbound
from dyknow.ros.transport.shared_memory import SharedMemory, connect_once
from dyknow.ros.transport.topics import RospyPublisher, RospySubscriber

ONE, TWO, THREE = "http://one", "http://two", "http://three"


def test_each_late_subscriber_receives_once_the_messages_that_it_missed():
    backlog = Backlog()
    backlog.keep("early")
    backlog.expect([], 10)
    backlog.keep("nobody is due")
    assert not backlog.waiting() and backlog.missed_by(ONE) == []
    backlog.expect([ONE, TWO], 10)
    backlog.keep(1)
    assert [backlog.missed_by(each) for each in (THREE, "", ONE)] == [[], [], [1]]
    backlog.forget({ONE})
    assert backlog.missed_by(ONE) == []
    backlog.keep(2)
    assert backlog.waiting()
    assert backlog.missed_by(TWO) == [1, 2]
    backlog.forget({TWO})
    assert not backlog.waiting() and backlog.missed_by(THREE) == []


@pytest.mark.parametrize(("size", "kept"), [(2, 2), (0, 1000)])
def test_the_oldest_messages_are_dropped(size, kept):
    backlog = Backlog()
    backlog.expect([ONE], size)
    for number in range(5000):
        backlog.keep(number)
    assert backlog.missed_by(ONE) == list(range(5000 - kept, 5000))


def test_more_messages_are_kept_once_a_publication_with_a_larger_queue_comes():
    backlog = Backlog()
    backlog.widen(5)  # no subscriber is expected
    backlog.expect([ONE, TWO, THREE], 1)
    for number, size in enumerate([1, 3, 2, 0]):
        backlog.keep(number)
        backlog.widen(size)
    for number in range(4, 10):
        backlog.keep(number)
    assert backlog.missed_by(ONE) == list(range(1, 10))


def test_a_dead_subscriber_is_given_up():
    now = [100.0]
    backlog = Backlog(lambda: now[0])
    backlog.expect([ONE], 10)
    backlog.keep(1)
    now[0] += LONGEST
    assert not backlog.waiting() and backlog.missed_by(ONE) == []


def test_it_is_looked_now_and_then_whether_a_subscriber_has_left():
    now = [100.0]
    backlog, looks = Backlog(lambda: now[0]), []
    backlog.look = lambda: looks.append(now[0] - 100.0)
    backlog.keep("nobody is due")
    backlog.expect([ONE], 10)
    for _ in range(80):
        backlog.keep(now[0])
        now[0] += 0.125
    assert looks == [0.5, 1.5, 3.5, 7.5]


class Surroundings:
    """The master and two subscribers, and time that is moved by hand."""

    def __init__(self, monkeypatch):
        self.now = 0.0
        self.subscribed = frozenset((ONE, TWO))
        self.connected = frozenset((ONE,))
        self.notified = []
        self.reminders = Reminders(self.register_again, lambda _: self.connected, lambda: self.now)
        # The test has its rounds.
        monkeypatch.setattr(self.reminders._worker, "start", lambda: None)

    def register_again(self, topic, datatype):
        self.notified.append((topic, datatype))
        return self.subscribed

    def come_back(self, away=0.1):
        self.reminders.withdrawn("/t")
        self.now += away
        self.advertise()

    def advertise(self):
        self.reminders.advertised("/t", "pkg/T", frozenset((ONE, TWO)))

    def wait(self, seconds):
        """Let time pass; returns how often all subscribers were notified again."""
        before = len(self.notified)
        for _ in range(round(seconds * 10)):
            self.now += 0.1
            self.reminders.remind()
        return len(self.notified) - before


@pytest.fixture(name="around")
def _around(monkeypatch):
    return Surroundings(monkeypatch)


def test_a_missing_subscriber_is_reminded_until_it_connects(around):
    around.come_back()
    assert around.wait(1.8) == 0, "it may just be busy"
    assert around.wait(10.0) > 2
    assert set(around.notified) == {("/t", "pkg/T")}
    around.connected = around.subscribed
    assert around.wait(100.0) == 0


def test_a_subscriber_that_never_connects_is_given_up(around):
    around.come_back()
    assert 4 <= around.wait(200.0) <= 8
    assert around.wait(200.0) == 0


@pytest.mark.parametrize(
    ("connected", "subscribed", "away", "reminders"),
    [
        ([ONE, TWO], [ONE, TWO], 0.1, 0),
        ([ONE], [ONE], 0.1, 1),  # the other one has unsubscribed, as this shows
        ([ONE], [ONE, TWO], LATELY + 1.0, 0),
    ],
)
def test_no_subscriber_that_is_there_or_gone_is_reminded(
    around, connected, subscribed, away, reminders
):
    around.connected, around.subscribed = frozenset(connected), frozenset(subscribed)
    around.come_back(away)
    assert around.wait(100.0) == reminders


def test_a_topic_that_is_new_or_withdrawn_again_needs_no_reminder(around):
    around.advertise()
    assert around.wait(10.0) == 0
    around.come_back()
    around.reminders.withdrawn("/t")
    assert around.wait(10.0) == 0


def test_a_master_that_is_away_is_asked_again(around):
    around.subscribed = None
    around.come_back()
    assert around.wait(10.0) > 2
    around.subscribed = frozenset((ONE, TWO))
    assert around.wait(10.0) > 0


# How long a port that is connected elsewhere waits for its new peers


PATIENCE = 0.5


class Graph:
    """Two publishers of a topic, a subscriber of it, and time that is moved by hand.

    Attributes:
        served_at: when each publisher has the subscriber among its connections.
        first_at: when the first message arrives.
        dead: publishers and subscribers that have ended, which the master lists all the same.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        self.served_at = {ONE: 0.1, TWO: 0.2}
        self.first_at = 3600.0
        self.dead: set[str] = set()
        self.late = LateSubscribers(lambda: self.now)
        connections = [
            SimpleNamespace(
                local_endpoint=("here", port),
                endpoint_id=uri,
                callerid_pub="/talker",
                stat_num_msg=0,
            )
            for port, uri in enumerate(self.served_at)
        ]
        self.first = connections[0]
        implementation = SimpleNamespace(connections=connections)
        publisher = mock.MagicMock(connections=[], latch=None, queue_size=1)
        rospy: Any = SimpleNamespace(
            Publisher=lambda *arguments, **options: SimpleNamespace(impl=publisher),
            Subscriber=lambda *arguments, **options: SimpleNamespace(impl=implementation),
            get_name=lambda: "/listener",
            resolve_name=lambda topic: topic,
        )
        monkeypatch.setattr(topics, "rospy", rospy)
        steady = SimpleNamespace(monotonic=lambda: self.now, sleep=self.passes)
        monkeypatch.setattr(topics, "time", steady)
        event = SimpleNamespace(wait=self.passes)
        monkeypatch.setattr(topics, "threading", SimpleNamespace(Event=lambda: event))
        monkeypatch.setattr(topics, "Master", lambda name: self)
        monkeypatch.setattr(topics, "refuses", lambda uri, timeout: uri in self.dead)

    def connections(self, uri: str, topic: str, timeout: float) -> set[int]:
        if uri not in self.served_at:
            raise PeerTimeout(uri, timeout)
        return {list(self.served_at).index(uri)} if self.now >= self.served_at[uri] else set()

    def passes(self, seconds: float) -> bool:
        self.now += seconds
        return False

    def arrived(self, seconds: float) -> bool:
        self.now += seconds
        self.first.stat_num_msg = int(self.now >= self.first_at)
        return self.now >= self.first_at

    def wait(self, publishers: Collection[str] = (ONE, TWO)) -> tuple[float, float]:
        """Return the seconds that the subscriber waits, and those until all would send to it."""
        registrar: Any = SimpleNamespace(publishers=lambda topic: frozenset(publishers))
        made = RospySubscriber(registrar, "/t", Header, lambda *message: None, {})
        made.wait(self.arrived, PATIENCE)
        waited = self.now
        made.wait_for_all(PATIENCE - waited)
        return waited, self.now

    def handles(self, *subscribers: str) -> OrdinaryHandles:
        executor = ManualExecutor()
        return OrdinaryHandles(
            "/t", "http://here", str, executor, lambda *each: None, lambda topic: subscribers
        )

    def announce(self, patience: float = PATIENCE) -> frozenset[str]:
        """Publish on a topic of both nodes; returns those that are expected after the wait."""
        handles = self.handles()
        intraprocess: Any = SimpleNamespace(publishing=lambda topic: handles)
        subscribers = lambda topic: frozenset((ONE, TWO))  # noqa: E731
        registrar: Any = SimpleNamespace(subscribers=subscribers, late=self.late)
        shared_memory: Any = SimpleNamespace()
        made = RospyPublisher(intraprocess, shared_memory, registrar, "/t", Header, False, 1, {})
        made.wait(patience)
        return handles.backlog.due


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Graph:
    return Graph(monkeypatch)


@pytest.mark.parametrize(
    ("case", "waits", "for_all"),
    [
        ("all are connected and silent", 0.2, 0.2),
        ("a first message comes", 0.05, 0.2),
        ("a first message comes from the only one", 0.05, 0.05),
        ("one does not answer", PATIENCE, PATIENCE),
        ("one is dead", 0.1, 0.1),
    ],
)
def test_how_long_publishers_are_waited_for(
    graph: Graph, case: str, waits: float, for_all: float
) -> None:
    if case.startswith("one"):
        del graph.served_at[TWO]
    if case.startswith("a first message comes"):
        graph.first_at = 0.05
    graph.dead = {TWO} if case == "one is dead" else set()
    waited = graph.wait([ONE] if case.endswith("only one") else [ONE, TWO])
    assert waited == pytest.approx((waits, for_all), abs=0.01)


@pytest.mark.parametrize(
    ("dead", "patience", "waits"),
    [({ONE, TWO}, PATIENCE, 0.05), ({ONE}, PATIENCE, PATIENCE), (set(), 0.0, 0.0)],
)
def test_who_was_notified_is_expected_unless_it_is_dead(graph, dead, patience, waits):
    graph.dead = dead
    assert graph.announce(patience) == {ONE, TWO} - dead
    assert graph.now == pytest.approx(waits, abs=0.01)


def test_a_subscriber_that_hangs_is_waited_for_on_its_first_topic_alone(graph: Graph) -> None:
    for _ in range(10):
        assert graph.announce() == {ONE, TWO}
    assert graph.now == pytest.approx(PATIENCE, abs=0.01)
    graph.now += 60.0
    graph.announce()
    assert graph.now == pytest.approx(60.0 + 2 * PATIENCE, abs=0.02)


def test_what_was_published_while_a_subscriber_was_away_is_not_for_it(graph: Graph) -> None:
    handles = graph.handles(TWO, THREE)
    handles.adopt(mock.MagicMock(connections=[], latch=None, queue_size=1))
    handles.expect([ONE, TWO])
    handles.forget_left()
    assert handles.backlog.due == {TWO}


def test_a_subscriber_whose_address_is_not_known_now_is_expected(graph: Graph) -> None:
    handles = graph.handles(TWO, "")
    handles.adopt(mock.MagicMock(connections=[], latch=None, queue_size=1))
    handles.expect([ONE, TWO])
    handles.forget_left()
    assert handles.backlog.due == {ONE, TWO}


# Two threads that learn of a publisher at the same time


class Link:
    """A connection to a publisher, over a pair of sockets."""

    def __init__(self, uri: str = ONE) -> None:
        self.endpoint_id, self.done = uri, False
        self.socket, self.far = socket.socketpair()


def closed_by_the_publisher(link):
    link.far.send(b"unread")
    link.far.close()


@pytest.mark.parametrize(
    ("change", "connects"),
    [
        (lambda link: None, False),
        (lambda link: setattr(link, "socket", None), False),
        (lambda link: setattr(link, "endpoint_id", TWO), True),
        (lambda link: setattr(link, "done", True), True),
        (lambda link: link.socket.close(), True),
        (closed_by_the_publisher, True),
    ],
    ids=["open", "being made", "to another one", "ended", "closed", "closed by the publisher"],
)
def test_a_connection_that_lives_is_not_replaced(change, connects):
    link = Link()
    with link.socket, link.far:
        change(link)
        subscriber = SimpleNamespace(c_lock=threading.RLock(), connections=[link])
        code, text, _ = connect_once(subscriber, ONE, lambda: (1, "connected", 0))
    assert (code, text) == (1, "connected" if connects else f"connected to {ONE} already")


@pytest.mark.parametrize("is_shared", [False, True])
def test_of_two_connections_to_a_publisher_the_first_stays(is_shared, monkeypatch):
    subscriber = _SubscriberImpl("/t", Header)
    manager = SimpleNamespace(get_subscriber_impl=lambda topic: subscriber)
    monkeypatch.setattr(registration, "_topic_manager", manager)
    monkeypatch.setattr(SharedMemory, "_reader", lambda handler, address: address)
    monkeypatch.setattr(tcpros_pubsub, "robust_connect_subscriber", lambda *args: None)
    if is_shared:
        connect, where = SharedMemory(True).create_transport, ["SHMROS", "localhost", 1, "address"]
    else:
        hook: Any = object.__new__(IntraProcess)
        hook._uri, hook._topics = THREE, {}
        hook._connect_outside = tcpros_pubsub.TCPROSHandler().create_transport
        connect, where = hook._create_transport, ["TCPROS", "localhost", 1]
    assert connect("/t", ONE, where)[0] == 1
    (first,) = subscriber.connections
    assert connect("/t", ONE, where)[0] == connect("/t", TWO, where)[0] == 1
    assert [each.endpoint_id for each in subscriber.connections] == [ONE, TWO]
    assert subscriber.connections[0] is first and not first.done


# A subscriber that connects while a publication is being made


class OutsideTopic:
    """rospy's topic ``/t`` of this process, and the subscriber ``ONE`` that connects to it.

    Attributes:
        manager: the topic manager of rospy.
        notified: what the master says of the subscribers.
        near, far: the sockets of the connection; the latter is the subscriber's.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.manager = rospy.topics._TopicManager()
        self.listeners = registration.RegistrationListeners()
        self.notified: frozenset[str] | None = frozenset({ONE})
        monkeypatch.setattr(registration, "_topic_manager", self.manager)
        monkeypatch.setattr(rospy.topics, "get_topic_manager", lambda: self.manager)
        monkeypatch.setattr(registration, "_registration_listeners", self.listeners)
        monkeypatch.setattr(rospy.core, "get_node_uri", lambda: THREE)
        monkeypatch.setattr(tcpros.get_tcpros_handler(), "create_transport", print)
        self.near, self.far = socket.socketpair()
        self.far.settimeout(DEADLINE)
        self._connection = TCPROSTransport(tcpros_pubsub.TCPROSPub("/t", Header), "/t")
        self._connection.set_socket(self.near, ONE)

    def advertise(self) -> RospyPublisher:
        memory: Any = SimpleNamespace(
            topics=set(),
            publish=lambda *message: False,
            outbound=lambda each, size: Outbound(each, size, None),
        )
        names: Any = SimpleNamespace(node=str, subscribers=set)
        registrar: Any = SimpleNamespace(
            subscribers=lambda topic: self.notified, late=LateSubscribers()
        )
        hook = IntraProcess(ManualExecutor(), memory)
        hook._master = names
        made = RospyPublisher(hook, memory, registrar, "/t", Header, False, 3, {})
        made.wait(0.0)
        return made

    def connect(self) -> None:
        self.manager.get_publisher_impl("/t").add_connection(self._connection)

    def received(self, last: bytes) -> bytes:
        """What has come when the last message is there."""
        found = b""
        while last not in found:
            found += self.far.recv(1000)
        return found


@pytest.fixture
def outside(monkeypatch, caplog):
    caplog.set_level(logging.INFO, "rospy.internal")
    topic = OutsideTopic(monkeypatch)
    yield topic
    topic.manager.close_all()
    for each in (topic.near, topic.far):
        each.close()


@pytest.fixture
def at_addition():
    """Call functions whenever rospy is about to add a connection."""
    internal = logging.getLogger("rospy.internal")
    filters: list[Any] = []

    def add(call) -> None:
        filters.append(lambda record: "adding connection" not in record.getMessage() or call())
        internal.addFilter(filters[-1])

    yield add
    for each in filters:
        internal.removeFilter(each)


@pytest.mark.parametrize("is_new", [True, False])
def test_a_subscriber_that_connects_at_the_registration_hears_all(is_new, outside, at_addition):
    """For good: nothing happens to the topic after that to say that it is there."""
    begun, may_end = threading.Event(), threading.Event()
    subscriber = threading.Thread(target=outside.connect)

    def hold_up() -> bool:
        begun.set()
        if not outside.manager.get_publisher_impl("/t").publock._is_owned():
            assert may_end.wait(DEADLINE)
        return True

    def connect() -> None:
        subscriber.start()
        assert begun.wait(DEADLINE)

    at_addition(hold_up)
    master: Any = registration.RegistrationListener()
    master.reg_added = lambda *topic: connect()
    outside.listeners.add_listener(master)
    try:
        if not is_new:
            outside.notified = None
            outside.manager.acquire_impl(registration.Registration.PUB, "/t", Header)
        made = outside.advertise()
        made.publish(Header(frame_id="early"))
        may_end.set()
        subscriber.join(DEADLINE)
        assert made.heard
        made.publish(Header(frame_id="heard"))
        received = outside.received(b"heard")
        assert (b"early" in received) is is_new, "only the master says that it is to come"
        (taken,) = made.peers()
        assert isinstance(taken, Outbound) and taken._queue_size == 3
        taken.close()
        assert not made.heard
    finally:
        may_end.set()


def test_what_is_published_while_a_late_subscriber_connects_reaches_it(
    outside, at_addition, monkeypatch
):
    made = outside.advertise()
    publisher = threading.Thread(target=made.publish, args=[Header(frame_id="between")])
    is_through = threading.Event()  # it has found that nobody listens, or waits for its turn
    held = topics.held

    def waits_for_its_turn(implementation):
        is_through.set()
        return held(implementation)

    def publish() -> bool:
        monkeypatch.setattr(topics, "held", waits_for_its_turn)
        publisher.start()
        while publisher.is_alive() and not is_through.wait(0.01):
            pass
        return True

    made.publish(Header(frame_id="early"))
    at_addition(publish)
    outside.connect()
    publisher.join(DEADLINE)
    made.publish(Header(frame_id="last"))
    received = outside.received(b"last")
    assert 0 < received.find(b"early") < received.find(b"between")


def test_a_subscriber_that_connects_as_it_becomes_expected_is_expected_no_more(outside):
    made = outside.advertise()
    handles = made._ordinary
    handles.forget_dead(lambda each: True)  # so far none is
    with handles._publisher_held():  # as while it is expected
        subscriber = threading.Thread(target=outside.connect)
        subscriber.start()
        eventually(lambda: handles._connecting)
        handles.backlog.expect({ONE}, 3)
        handles.backlog.keep(Header(frame_id="early"))
    subscriber.join(DEADLINE)
    assert not handles.backlog.due
    assert b"early" in outside.received(b"early")
