# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A publisher's subscriber_listener: lazy nodelets work only while they have subscribers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from unit.nodelet.fakes import Message, World, numbers

import dyknow
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

    def news(self):
        """The calls since the last question."""
        notes, self.notes = self.notes, []
        return notes


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


def test_subscribers_of_the_process_are_one_peer_and_each_outside_is_one(world, nh, listener):
    nh.Subscriber("early", Message, print)
    world.transport.listen("/early", print)
    advertise(nh, listener, "early")
    world.drain()
    assert listener.news() == [("subscribe", "/early", 2)] * 2
    advertise(nh, listener)
    subscribers = [world.handle(name).Subscriber("t", Message, print) for name in ("/a", "/b")]
    world.drain()
    assert listener.news() == [("subscribe", "/t", 1)]
    world.transport.listen("/t", print)
    world.drain()
    assert listener.news() == [("subscribe", "/t", 2)]
    subscribers[0].unregister()
    world.drain()
    assert listener.news() == []
    subscribers[1].unregister()
    world.drain()
    world.transport.stop_listening("/t", print)
    world.drain()
    assert listener.news() == [("unsubscribe", "/t", 1), ("unsubscribe", "/t", 0)]


def test_one_peer_alone_can_be_sent_something_until_it_leaves(world, nh, listener):
    inside, outside, other = [], [], []
    advertise(nh, listener)
    nh.Subscriber("t", Message, inside.append)
    world.drain()
    for got in (outside, other):
        world.transport.listen("/t", got.append)
        world.drain()
    for number, to_peer in enumerate(listener.to_peer):
        to_peer(Message(number))
    world.drain()
    world.transport.stop_listening("/t", outside.append)
    listener.to_peer[1](Message("late"))
    assert [numbers(each) for each in (inside, outside, other)] == [[0], [1], [2]]


def test_each_handle_of_a_topic_has_a_listener_until_it_is_unregistered_or_unloaded(world, nh):
    class Faulty(Listener):
        def peer_subscribe(self, *args):
            raise RuntimeError("on purpose")

    first, second, gone = Listener(), Listener(), Listener()
    advertise(nh, Faulty())
    publisher = advertise(nh, first)
    nh.Subscriber("t", Message, print)
    world.drain()
    advertise(world.handle("/other"), second)
    world.drain()
    going = world.handle("/gone")
    advertise(going, gone)
    going.context.close()
    publisher.unregister()
    world.drain()
    assert first.notes == second.notes == [("subscribe", "/t", 1)]
    assert gone.notes == []
    assert nh.context.callback_errors == 1, "one that raises keeps no other from its call"


def test_a_latched_message_is_delivered_once_and_a_message_for_one_peer_is_not_latched(
    world, nh, listener
):
    got, later = [], []
    publisher = advertise(nh, listener, latch=True)
    publisher.publish(1)
    nh.Subscriber("t", Message, got.append)
    world.drain()
    listener.to_peer[0](Message(7))
    nh.Subscriber("t", Message, later.append)
    world.drain()
    assert (numbers(got), numbers(later)) == ([1, 7], [1])
    assert listener.notes == [("subscribe", "/t", 1)]


def test_a_port_that_moves_to_other_subscribers_keeps_at_least_one(world, listener):
    handles = {name: dyknow.NodeHandle(world.handle(f"/{name}")) for name in ("out", "in")}
    advertise(handles["out"], listener, "out")
    handles["in"].Subscriber("in", Message, print)
    world.handle("/other").Subscriber("/b", Message, print)
    for port, topic, news in (
        ("out", "/a", []),
        ("in", "/x", []),
        ("in", "/a", [("subscribe", "/a", 1)]),
        ("out", "/b", [("subscribe", "/b", 1), ("unsubscribe", "/a", 1)]),
        ("out", "/c", [("unsubscribe", "/b", 0)]),
        ("in", "/c", [("subscribe", "/c", 1)]),
    ):
        NodeletProxy.of(handles[port].context).set_config([(port, topic)])
        world.drain()
        assert listener.news() == news, topic
    handles["in"].context.close()
    world.drain()
    assert listener.news() == [("unsubscribe", "/c", 0)]


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
