# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Registrations outside: when they are made, fed, and withdrawn."""

from __future__ import annotations

from typing import Callable

import pytest
from unit.nodelet.fakes import Message, in_thread, join, numbers

from dyknow.errors import HandleClosed
from dyknow.nodelet.local import LocalPublisher, LocalSubscriber


def test_topics_are_registered_and_withdrawn(world):
    nh = world.handle()
    publisher = nh.Publisher("a", Message, queue_size=1)
    subscriber = nh.Subscriber("a", Message, print)
    nh.Subscriber("b", Message, print)
    assert world.registrations == [
        ("publisher", "/a"),
        ("subscriber", "/a"),
        ("subscriber", "/b"),
    ]
    publisher.unregister()
    subscriber.unregister()
    assert world.registrations == [("subscriber", "/b")]
    nh.context.close()
    assert world.registrations == []


def test_moves_leave_one_registration_for_each_endpoint(world):
    nh = world.handle()
    publisher = nh.Publisher("a", Message, queue_size=1)
    subscriber = nh.Subscriber("a", Message, print)
    ends = [publisher.publication, subscriber.subscription]
    for topic in ("/b", "/c", "/a", "/d"):
        world.bus.rewire([(end, topic) for end in ends])
        assert world.registrations == [("publisher", topic), ("subscriber", topic)]
        assert [end.topic for end in ends] == [topic, topic]
    world.bus.rewire([(end, "") for end in ends])
    assert world.registrations == []
    nh.context.close()
    assert world.registrations == []


def test_an_endpoint_that_is_there_already_keeps_its_registration(world):
    nh = world.handle()
    publisher = nh.Publisher("a", Message, queue_size=1)
    before = list(world.transport.made)
    world.bus.rewire([(publisher.publication, "/a")])
    assert world.transport.made == before


def test_a_new_connection_is_made_before_the_old_one_is_broken(world):
    nh = world.handle()
    publisher = nh.Publisher("a", Message, queue_size=1)
    subscriber = nh.Subscriber("x", Message, print)
    seen = []
    world.transport.on_register = lambda topic: seen.append((topic, world.registrations))
    world.bus.rewire([(publisher.publication, "/b"), (subscriber.subscription, "/y")])
    both = [("publisher", "/a"), ("subscriber", "/x")]
    assert seen[0] == ("/b", both)
    assert seen[1] == ("/y", sorted([*both, ("publisher", "/b")]))


def test_a_message_goes_out_only_if_somebody_listens(world):
    nh = world.handle()
    publisher = nh.Publisher("t", Message, queue_size=1)
    (registration,) = world.transport.made
    sent = []
    registration.publish = sent.append
    publisher.publish(1)
    assert sent == []
    registration.connections.append(print)
    message = Message(2)
    publisher.publish(message)
    assert sent == [message]


def test_it_goes_out_once_however_many_listen_inside(world):
    got, outside = [], []
    nh = world.handle()
    for _ in range(3):
        nh.Subscriber("t", Message, got.append)
    publisher = nh.Publisher("t", Message, queue_size=1)
    world.transport.listeners["/t"].append(outside.append)
    publisher.publish(1)
    world.drain()
    assert numbers(outside) == [1]
    assert numbers(got) == [1, 1, 1]


def test_messages_from_outside_reach_each_subscriber_once(world):
    got = []
    nh = world.handle()
    nh.Subscriber("t", Message, got.append)
    nh.Subscriber("t", Message, got.append)
    world.transport.send("/t", Message(1))
    assert got == []
    world.drain()
    assert numbers(got) == [1, 1]


def test_messages_from_outside_that_come_during_the_switch_follow_the_old_ones(world):
    got = []
    nh = world.handle()
    subscriber = nh.Subscriber("old", Message, got.append)
    world.transport.send("/old", Message("old"))

    class Early(type(world.transport.made[0])):
        def wait(self, arrived, seconds):
            self.receive(Message("new"))
            assert arrived(0.0)

    subscribe = world.transport.subscribe

    def early_subscribe(topic, datatype, receive, options):
        registration = subscribe(topic, datatype, receive, options)
        registration.__class__ = Early
        return registration

    world.transport.subscribe = early_subscribe
    world.bus.rewire(
        [(subscriber.subscription, "/new")],
        on_switch=lambda: nh.context.strand.post(lambda: got.append(Message("between"))),
        patience=1.0,
    )
    world.drain()
    assert numbers(got) == ["old", "between", "new"]


def test_what_comes_late_through_an_old_registration_is_not_delivered(world):
    got = []
    nh = world.handle()
    subscriber = nh.Subscriber("old", Message, got.append)
    (old,) = world.transport.made
    world.bus.rewire([(subscriber.subscription, "/new")])
    old.receive(Message("late"))
    world.drain()
    assert got == []


def test_a_latched_message_is_handed_to_the_half_that_comes_later(world):
    nh = world.handle()
    nh.Subscriber("new", Message, print)  # so that the switch goes before the registration
    publisher = nh.Publisher("old", Message, latch=True, queue_size=1)
    publisher.publish(1)
    outside = world.transport.listeners.setdefault("/new", [])
    got = []
    outside.append(got.append)
    world.bus.rewire([(publisher.publication, "/new")])
    assert numbers(got) == [1]


@pytest.mark.parametrize("alive", [False, True])
def test_what_is_published_during_a_latched_switch_is_the_last_word_outside(world, alive):
    nh = world.handle()
    if alive:
        nh.Subscriber("new", Message, print)
    publisher = nh.Publisher("old", Message, latch=True, queue_size=1)
    publisher.publish(1)
    got = []

    def listen(message):
        got.append(message)
        if len(got) == 1:  # another thread publishes while the latched message is handed over
            publisher.publish(2)
            got.append(message)

    world.transport.listeners.setdefault("/new", []).append(listen)
    world.bus.rewire([(publisher.publication, "/new")])
    assert numbers(got)[0] == 1
    assert numbers(got)[-1] == 2


def test_a_refused_registration_leaves_nothing_of_a_handle(world):
    nh = world.handle()
    error = RuntimeError("the master is gone")
    world.transport.refused["/t"] = error
    for make in (nh.Publisher, nh.Subscriber):
        with pytest.raises(RuntimeError, match="the master is gone"):
            make("t", Message)
    assert world.registrations == []
    assert world.bus.datatype_of("/t") == ""
    assert nh.context._endpoints == []


def test_a_refused_registration_on_a_topic_that_is_alive_leaves_nothing(world):
    nh = world.handle()
    publisher = nh.Publisher("t", Message, queue_size=1)
    world.transport.refused["/t"] = RuntimeError("no")
    got = []
    with pytest.raises(RuntimeError):
        nh.Subscriber("t", Message, got.append)
    publisher.publish(1)
    world.drain()
    assert got == []
    assert world.registrations == [("publisher", "/t")]


def test_a_refused_registration_undoes_the_whole_switch(world):
    got = []
    nh = world.handle()
    publisher = nh.Publisher("a", Message, queue_size=1)
    subscriber = nh.Subscriber("a", Message, got.append)
    before = world.registrations
    world.transport.refused["/c"] = RuntimeError("no")
    told = []
    with pytest.raises(RuntimeError):
        world.bus.rewire(
            [(publisher.publication, "/b"), (subscriber.subscription, "/c")],
            on_switch=lambda: told.append(1),
        )
    assert told == []
    assert world.registrations == before
    assert publisher.name == subscriber.name == "/a"
    publisher.publish(1)
    world.drain()
    assert numbers(got) == [1]
    assert world.bus.datatype_of("/b") == world.bus.datatype_of("/c") == ""


def test_a_refused_registration_of_a_live_topic_leaves_no_old_ones(world):
    # Inside, the switch is done by then: it remains to report the truth and drop the old topic.
    got = []
    nh, other = world.handle(), world.handle("/other")
    other.Subscriber("/b", Message, got.append)
    other.Subscriber("/d", Message, got.append)
    first, second = (nh.Publisher(topic, Message, queue_size=1) for topic in ("a", "c"))
    world.transport.refused["/b"] = RuntimeError("no")
    with pytest.raises(RuntimeError, match="no"):
        world.bus.rewire([(first.publication, "/b"), (second.publication, "/d")])
    assert (first.name, second.name) == ("/b", "/d")
    first.publish(1)
    second.publish(2)
    world.drain()
    assert numbers(got) == [1, 2]
    assert world.registrations == [
        ("publisher", "/d"),
        ("subscriber", "/b"),
        ("subscriber", "/d"),
    ]


def test_nothing_is_registered_after_an_unload_while_peers_are_waited_for(world):
    nh = world.handle()
    publisher = nh.Publisher("a", Message, queue_size=1)
    subscriber = nh.Subscriber("a", Message, print)
    seen = []

    class Slow(LocalPublisher):
        def wait(self, seconds):
            seen.append(world.registrations)
            join(in_thread(nh.context.close))
            seen.append(world.registrations)

    advertise = world.transport.advertise

    def slow_advertise(*args):
        registration = advertise(*args)
        registration.__class__ = Slow
        return registration

    world.transport.advertise = slow_advertise
    moves = [(publisher.publication, "/b"), (subscriber.subscription, "/c")]
    with pytest.raises(HandleClosed):
        world.bus.rewire(moves, patience=1.0)
    before, after = seen
    assert len(before) == 4
    assert after == []
    assert world.registrations == []


class Draining(LocalSubscriber):
    """Calls a function when it is drained, as long as it still receives."""

    on_drain: Callable[[], None]

    def drain(self, seconds):
        self.on_drain()
        super().drain(seconds)


def test_what_comes_until_the_switch_is_delivered_before_the_new(world):
    got = []
    nh = world.handle()
    subscriber = nh.Subscriber("old", Message, got.append)
    (registration,) = world.transport.subscribers
    registration.__class__ = Draining

    def last_words():
        world.transport.send("/new", Message("new"))
        world.transport.send("/old", Message("last"))

    registration.on_drain = last_words
    world.bus.rewire(
        [(subscriber.subscription, "/new")],
        lambda: world.transport.send("/old", Message("late")),
        patience=1.0,
    )
    world.drain()
    assert numbers(got) == ["last", "new"]


def test_a_switch_that_fails_after_the_last_words_leaves_the_port_receiving(world):
    got = []
    nh, other = world.handle(), world.handle("/other")
    subscriber = nh.Subscriber("old", Message, got.append)
    publisher = other.Publisher("out", Message, queue_size=1)
    (registration,) = world.transport.subscribers
    registration.__class__ = Draining
    registration.on_drain = lambda: join(in_thread(other.context.close))
    moves = [(subscriber.subscription, "/new"), (publisher.publication, "/a")]
    with pytest.raises(HandleClosed):
        world.bus.rewire(moves, patience=1.0)
    assert world.registrations == [("subscriber", "/old")]
    world.transport.send("/old", Message(1))
    world.drain()
    assert numbers(got) == [1]
    nh.context.close()
    assert world.registrations == []


def test_a_nodelet_unloaded_during_the_last_words_of_its_topic_leaves_nothing(world):
    nh = world.handle()
    subscriber = nh.Subscriber("old", Message, print)
    (registration,) = world.transport.subscribers
    registration.__class__ = Draining
    registration.on_drain = lambda: join(in_thread(nh.context.close))
    with pytest.raises(HandleClosed):
        world.bus.rewire([(subscriber.subscription, "/new")], patience=1.0)
    assert world.registrations == []


def test_a_nodelet_unloaded_while_its_topic_is_registered_leaves_nothing_and_no_wait(world):
    nh = world.handle()
    publisher = nh.Publisher("a", Message, queue_size=1)
    world.transport.on_register = lambda topic: join(in_thread(nh.context.close))
    advertise, waited = world.transport.advertise, []

    def impatient_advertise(*args):
        registration = advertise(*args)
        registration.wait = waited.append
        return registration

    world.transport.advertise = impatient_advertise
    with pytest.raises(HandleClosed):
        world.bus.rewire([(publisher.publication, "/b")], patience=1.0)
    assert waited == []
    assert world.registrations == []
    assert world.bus.datatype_of("/b") == ""


def test_a_nodelet_unloaded_while_a_live_topic_is_registered_leaves_nothing(world):
    world.handle("/other").Subscriber("/b", Message, print)
    nh = world.handle()
    publisher = nh.Publisher("a", Message, queue_size=1)
    world.transport.on_register = lambda topic: join(in_thread(nh.context.close))
    world.bus.rewire([(publisher.publication, "/b")])
    assert world.registrations == [("subscriber", "/b")]
    with pytest.raises(HandleClosed):
        publisher.publish(1)


def test_a_handle_being_made_while_its_nodelet_is_unloaded_leaves_nothing(world):
    nh = world.handle()
    world.transport.on_register = lambda topic: join(in_thread(nh.context.close))
    with pytest.raises(HandleClosed):
        nh.Publisher("a", Message, queue_size=1)
    assert world.registrations == []


def test_connections_are_counted_as_in_roscpp(world):
    nh = world.handle()
    publisher = nh.Publisher("t", Message, queue_size=1)
    assert publisher.get_num_connections() == 0
    nh.Subscriber("t", Message, print)
    nh.Subscriber("t", Message, print)
    assert publisher.get_num_connections() == 1
    world.transport.listeners["/t"].extend([print, print])
    assert publisher.get_num_connections() == 3
