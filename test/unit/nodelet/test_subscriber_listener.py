# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A publisher's subscriber_listener: lazy nodelets work only while they have subscribers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from unit.nodelet.fakes import Message, World, numbers

import dyknow
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.proxy.proxy import NodeletProxy


class Listener:
    """Records each call, with the result of ``count`` at that moment."""

    def __init__(self, count=lambda: None):
        self.notes = []
        self.to_peer = []
        self.count = count

    def peer_subscribe(self, topic, publish, publish_to_peer):
        self.notes.append(("subscribe", topic, self.count()))
        self.to_peer.append(publish_to_peer)

    def peer_unsubscribe(self, topic, number):
        self.notes.append(("unsubscribe", topic, number))
        assert self.count() in (None, number)


class Lazy:
    """Relays from ``source`` to ``target``, only while ``target`` has subscribers."""

    def __init__(self, nh, source, target):
        self.nh, self.source = nh, source
        self.sub = None
        self.pub = nh.Publisher(target, Message, subscriber_listener=self, queue_size=9)

    def peer_subscribe(self, topic, publish, publish_to_peer):
        if self.sub is None:
            self.sub = self.nh.Subscriber(self.source, Message, self.pub.publish)

    def peer_unsubscribe(self, topic, number):
        if number == 0 and self.sub is not None:
            self.sub.unregister()
            self.sub = None


@pytest.fixture(name="nh")
def _nh(world):
    return world.handle()


@pytest.fixture(name="listener")
def _listener():
    return Listener()


def advertise(nh, listener, topic="t", **options):
    publisher = nh.Publisher(topic, Message, subscriber_listener=listener, queue_size=9, **options)
    listener.count = publisher.get_num_connections
    return publisher


def test_subscribers_of_the_process_are_one_peer(world, nh, listener):
    advertise(nh, listener)
    first = world.handle("/first").Subscriber("t", Message, print)
    second = world.handle("/second").Subscriber("t", Message, print)
    world.drain()
    assert listener.notes == [("subscribe", "/t", 1)]
    first.unregister()
    world.drain()
    assert listener.notes[1:] == []
    second.unregister()
    world.drain()
    assert listener.notes[1:] == [("unsubscribe", "/t", 0)]


def test_subscribers_that_were_there_before(world, nh, listener):
    nh.Subscriber("t", Message, print)
    world.transport.listen("/t", print)
    advertise(nh, listener)
    world.drain()
    assert listener.notes == [("subscribe", "/t", 2)] * 2


def test_inside_and_outside_are_counted_together(world, nh, listener):
    advertise(nh, listener)
    sub = nh.Subscriber("t", Message, print)
    world.drain()
    world.transport.listen("/t", print)
    world.drain()
    assert listener.notes == [("subscribe", "/t", 1), ("subscribe", "/t", 2)]
    sub.unregister()
    world.drain()
    world.transport.stop_listening("/t", print)
    world.drain()
    assert listener.notes[2:] == [("unsubscribe", "/t", 1), ("unsubscribe", "/t", 0)]


def test_one_peer_alone_can_be_sent_something(world, nh, listener):
    inside, outside, other = [], [], []
    advertise(nh, listener)
    nh.Subscriber("t", Message, inside.append)
    world.drain()
    world.transport.listen("/t", outside.append)
    world.drain()
    world.transport.listen("/t", other.append)
    world.drain()
    for number, to_peer in enumerate(listener.to_peer):
        to_peer(Message(number))
    world.drain()
    assert [numbers(each) for each in (inside, outside, other)] == [[0], [1], [2]]


def test_a_peer_that_has_left_is_sent_nothing(world, nh, listener):
    got = []
    advertise(nh, listener)
    world.transport.listen("/t", got.append)
    world.drain()
    world.transport.stop_listening("/t", got.append)
    listener.to_peer[0](Message(1))
    assert got == []


def test_each_handle_of_a_topic_has_a_listener(world, nh):
    first, second = Listener(), Listener()
    publisher = advertise(nh, first)
    nh.Subscriber("t", Message, print)
    world.drain()
    advertise(world.handle("/other"), second)
    world.drain()
    assert first.notes == second.notes == [("subscribe", "/t", 1)]
    publisher.unregister()
    world.drain()
    assert len(first.notes) == 1


def test_a_nodelet_that_is_unloaded_is_told_nothing(world, nh, listener):
    advertise(nh, listener)
    world.handle("/other").Subscriber("t", Message, print)
    nh.context.close()
    world.drain()
    assert listener.notes == []


def test_a_listener_that_raises_is_counted_and_the_others_are_told(world, nh, listener):
    class Faulty(Listener):
        def peer_subscribe(self, *args):
            raise RuntimeError("on purpose")

    advertise(nh, Faulty())
    advertise(nh, listener)
    nh.Subscriber("t", Message, print)
    world.drain()
    assert listener.notes == [("subscribe", "/t", 1)]
    assert nh.context.callback_errors == 1


def test_a_latched_message_is_delivered_once(world, nh, listener):
    got = []
    publisher = advertise(nh, listener, latch=True)
    publisher.publish(1)
    nh.Subscriber("t", Message, got.append)
    world.drain()
    assert numbers(got) == [1]
    assert listener.notes == [("subscribe", "/t", 1)]


def test_what_one_peer_was_sent_is_not_latched(world, nh, listener):
    got = []
    publisher = advertise(nh, listener, latch=True)
    publisher.publish(1)
    nh.Subscriber("t", Message, print)
    world.drain()
    listener.to_peer[0](Message(7))
    nh.Subscriber("t", Message, got.append)
    world.drain()
    assert numbers(got) == [1]


class Ports:
    """A nodelet with an out-port and one with an in-port."""

    def __init__(self, world, listener):
        self.source = dyknow.NodeHandle(world.handle("/source"))
        self.sink = dyknow.NodeHandle(world.handle("/sink"))
        self.pub = advertise(self.source, listener, "out")
        self.sink.Subscriber("in", Message, print)
        self.world = world

    def connect(self, out=None, into=None):
        for nh, port, topic in ((self.source, "out", out), (self.sink, "in", into)):
            if topic is not None:
                NodeletProxy.of(nh.context).set_config([(port, topic)])
        self.world.drain()


@pytest.fixture(name="ports")
def _ports(world, listener):
    return Ports(world, listener)


def test_a_port_is_told_when_both_ends_have_met(ports, listener):
    ports.connect(out="/a")
    ports.connect(into="/b")
    assert listener.notes == []
    ports.connect(into="/a")
    assert listener.notes == [("subscribe", "/a", 1)]
    ports.connect(into="")
    assert listener.notes[1:] == [("unsubscribe", "/a", 0)]


def test_a_port_that_moves_to_other_listeners_keeps_at_least_one(world, ports, listener):
    ports.connect(out="/a", into="/a")
    world.handle("/other").Subscriber("/b", Message, print)
    ports.connect(out="/b")
    assert listener.notes == [
        ("subscribe", "/a", 1),
        ("subscribe", "/b", 1),
        ("unsubscribe", "/a", 1),
    ]
    ports.connect(out="/c")
    assert listener.notes[3:] == [("unsubscribe", "/b", 0)]
    ports.connect(into="/c")
    assert listener.notes[4:] == [("subscribe", "/c", 1)]
    ports.connect(out="")
    assert listener.notes[5:] == [("unsubscribe", "/c", 0)]


def test_an_unloaded_consumer_of_a_port(ports, listener):
    ports.connect(out="/a", into="/a")
    ports.sink.context.close()
    ports.world.drain()
    assert listener.notes == [("subscribe", "/a", 1), ("unsubscribe", "/a", 0)]


@pytest.mark.parametrize("wrap", [lambda nh: nh, dyknow.NodeHandle], ids=["plain", "ports"])
def test_a_chain_of_lazy_nodelets_follows_its_consumer(world, wrap):
    topics = [f"/t{number}" for number in range(5)]
    chain = []
    for number, (source, target) in enumerate(zip(topics, topics[1:])):
        context = world.context(f"/n{number}", remappings={"/in": source, "/out": target})
        handle = PlainNodeHandle(context, "/")
        chain.append(Lazy(wrap(handle), "in", "out"))
    first = world.handle("/first").Publisher("/t0", Message, queue_size=9)
    world.drain()
    assert first.get_num_connections() == 0
    for number in range(3):
        got = []
        sub = world.handle("/last").Subscriber("/t4", Message, got.append)
        world.drain()
        assert first.get_num_connections() == 1
        first.publish(number)
        world.drain()
        assert numbers(got) == [number]
        sub.unregister()
        world.drain()
        assert first.get_num_connections() == 0
        assert [lazy.sub for lazy in chain] == [None] * 4


def test_a_consumer_that_is_wired_to_a_lazy_port_starts_it(world, listener):
    ports = Ports(world, Listener())
    lazy = Lazy(ports.source, "frames", "lazy")
    NodeletProxy.of(ports.source.context).set_config([("lazy", "/lazy")])
    world.drain()
    assert lazy.sub is None
    ports.connect(into="/lazy")
    assert lazy.sub is not None
    ports.connect(into="/elsewhere")
    assert lazy.sub is None


TOPICS = ("", "/a", "/b")
MOVES = st.one_of(
    st.tuples(st.sampled_from(("out", "one", "two")), st.sampled_from(TOPICS)),
    st.tuples(st.sampled_from(("outside", "drain")), st.sampled_from(TOPICS[1:])),
)


@given(st.lists(MOVES, max_size=30))
def test_the_listener_and_the_count_agree_after_any_changes(moves):
    world, listener = World(), Listener()
    handles = {name: dyknow.NodeHandle(world.handle(f"/{name}")) for name in ("out", "one", "two")}
    publisher = advertise(handles["out"], listener, "out")
    listener.count = lambda: None
    for name in ("one", "two"):
        handles[name].Subscriber(name, Message, print)
    for what, topic in moves:
        if what in handles:
            NodeletProxy.of(handles[what].context).set_config([(what, topic)])
        elif what == "drain":
            world.drain()
        elif world.transport.listeners.get(topic):
            world.transport.stop_listening(topic, print)
        else:
            world.transport.listen(topic, print)
    world.drain()
    count = 0
    for kind, _, number in listener.notes:
        count += 1 if kind == "subscribe" else -1
        assert number in (None, count)
    assert count == publisher.get_num_connections()
