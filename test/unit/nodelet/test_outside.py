# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Registrations outside: when they are made, fed, and withdrawn."""

from __future__ import annotations

from typing import Callable

import pytest
from unit.nodelet.fakes import Message, in_thread, join, numbers

from dyknow.errors import HandleClosed
from dyknow.nodelet.local import LocalSubscriber


class Draining(LocalSubscriber):
    """Calls a function when it is drained, as long as it still receives."""

    on_drain: Callable[[], None]

    def drain(self, seconds):
        self.on_drain()
        super().drain(seconds)


@pytest.fixture(name="nh")
def _nh(world):
    return world.handle()


def drain_by(registration, on_drain):
    registration.__class__, registration.on_drain = Draining, on_drain


def test_an_endpoint_that_is_there_already_keeps_its_registration(world, nh):
    publisher = nh.Publisher("a", Message, queue_size=1)
    before = list(world.transport.made)
    world.bus.rewire([(publisher.publication, "/a")])
    assert world.transport.made == before


def test_a_new_connection_is_made_before_the_old_one_is_broken(world, nh):
    publisher = nh.Publisher("a", Message, queue_size=1)
    subscriber = nh.Subscriber("x", Message, print)
    seen = []
    world.transport.on_register = lambda topic: seen.append((topic, world.registrations))
    world.bus.rewire([(publisher.publication, "/b"), (subscriber.subscription, "/y")])
    both = [("publisher", "/a"), ("subscriber", "/x")]
    assert seen == [("/b", both), ("/y", sorted([*both, ("publisher", "/b")]))]


def test_a_message_goes_out_once_and_only_if_somebody_listens(world, nh):
    got, sent = [], []
    for _ in range(3):
        nh.Subscriber("t", Message, got.append)
    publisher = nh.Publisher("t", Message, queue_size=1)
    registration = world.transport.made[-1]
    registration.publish = sent.append
    publisher.publish(1)
    assert sent == []
    registration.connections.append(print)
    message = Message(2)
    publisher.publish(message)
    world.drain()
    assert sent == [message]
    assert numbers(got) == [1, 1, 1, 2, 2, 2]


def test_messages_from_outside_that_come_during_the_switch_follow_the_old_ones(world, nh):
    got = []
    subscriber = nh.Subscriber("old", Message, got.append)
    world.transport.send("/old", Message("old"))

    class Early(LocalSubscriber):
        def wait(self, arrived, seconds):
            self.receive(Message("new"))
            assert arrived(0.0)

    world.transport.on_made = lambda made: setattr(made, "__class__", Early)
    world.bus.rewire(
        [(subscriber.subscription, "/new")],
        on_switch=lambda: nh.context.strand.post(lambda: got.append(Message("between"))),
        patience=1.0,
    )
    world.drain()
    assert numbers(got) == ["old", "between", "new"]


def test_messages_until_the_switch_go_before_the_new_and_later_ones_are_dropped(world, nh):
    got = []
    subscriber = nh.Subscriber("old", Message, got.append)
    (old,) = world.transport.made

    def last_words():
        world.transport.send("/new", Message("new"))
        world.transport.send("/old", Message("last"))

    drain_by(old, last_words)
    world.bus.rewire(
        [(subscriber.subscription, "/new")],
        lambda: world.transport.send("/old", Message("late")),
        patience=1.0,
    )
    old.receive(Message("later"))
    world.drain()
    assert numbers(got) == ["last", "new"]


@pytest.mark.parametrize("alive", [False, True])
def test_the_last_latched_message_stays_outside(world, nh, alive):
    if alive:  # so that the switch goes before the registration
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


@pytest.mark.parametrize("alive", [False, True])
def test_a_refused_registration_leaves_nothing_of_a_handle(world, nh, alive):
    publisher = world.publisher("/t") if alive else None
    before = world.registrations
    world.transport.refused["/t"] = RuntimeError("the master is gone")
    for make in (nh.Publisher, nh.Subscriber):
        with pytest.raises(RuntimeError, match="the master is gone"):
            make("t", Message)
    assert world.registrations == before
    assert nh.context._endpoints == []
    if publisher is not None:
        publisher.publish(1)
    else:
        assert world.bus.datatype_of("/t") == ""


def test_a_refused_registration_undoes_the_whole_switch(world, nh):
    got, switched = [], []
    publisher = nh.Publisher("a", Message, queue_size=1)
    subscriber = nh.Subscriber("a", Message, got.append)
    before = world.registrations
    world.transport.refused["/c"] = RuntimeError("no")
    with pytest.raises(RuntimeError):
        world.bus.rewire(
            [(publisher.publication, "/b"), (subscriber.subscription, "/c")],
            on_switch=lambda: switched.append(1),
        )
    assert switched == []
    assert world.registrations == before
    assert publisher.name == subscriber.name == "/a"
    publisher.publish(1)
    world.drain()
    assert numbers(got) == [1]
    assert world.bus.datatype_of("/b") == world.bus.datatype_of("/c") == ""


def test_a_refused_registration_of_a_live_topic_leaves_no_old_ones(world, nh):
    # Inside, the switch is done by then: it remains to report the truth and drop the old topic.
    got, other = [], world.handle("/other")
    for topic in ("/b", "/d"):
        other.Subscriber(topic, Message, got.append)
    first, second = (nh.Publisher(topic, Message, queue_size=1) for topic in ("a", "c"))
    world.transport.refused["/b"] = RuntimeError("no")
    with pytest.raises(RuntimeError, match="no"):
        world.bus.rewire([(first.publication, "/b"), (second.publication, "/d")])
    assert (first.name, second.name) == ("/b", "/d")
    first.publish(1)
    second.publish(2)
    world.drain()
    assert numbers(got) == [1, 2]
    assert world.registrations == [("publisher", "/d"), ("subscriber", "/b"), ("subscriber", "/d")]


def test_a_switch_that_fails_after_the_last_words_leaves_the_port_receiving(world, nh):
    got, other = [], world.handle("/other")
    subscriber = nh.Subscriber("old", Message, got.append)
    publisher = other.Publisher("out", Message, queue_size=1)
    drain_by(world.transport.subscribers[0], lambda: join(in_thread(other.context.close)))
    moves = [(subscriber.subscription, "/new"), (publisher.publication, "/a")]
    with pytest.raises(HandleClosed):
        world.bus.rewire(moves, patience=1.0)
    assert world.registrations == [("subscriber", "/old")]
    world.transport.send("/old", Message(1))
    world.drain()
    assert numbers(got) == [1]
    nh.context.close()
    assert world.registrations == []


@pytest.mark.parametrize("moment", ["waiting for peers", "last words", "registering"])
def test_a_nodelet_unloaded_amid_its_switch_leaves_nothing(world, nh, moment):
    seen = []

    def unload(*args):
        seen.append(len(world.registrations))
        join(in_thread(nh.context.close))
        seen.append(len(world.registrations))

    def wait(*args):
        assert moment == "waiting for peers", "no peer is waited for after the unload"
        if not seen:
            unload()

    publisher = nh.Publisher("a", Message, queue_size=1)
    subscriber = nh.Subscriber("a", Message, print)
    if moment == "last words":
        drain_by(world.transport.subscribers[0], unload)
    else:
        world.transport.on_made = lambda made: setattr(made, "wait", wait)
    if moment == "registering":
        world.transport.on_register = unload
    moves = [(subscriber.subscription, "/c"), (publisher.publication, "/b")]
    with pytest.raises(HandleClosed):
        world.bus.rewire(moves[1:] if moment == "registering" else moves, patience=1.0)
    assert seen == [2 if moment == "registering" else 4, 0]
    assert world.registrations == []
    assert world.bus._topics == {}


def test_a_nodelet_unloaded_while_a_live_topic_is_registered_leaves_nothing(world, nh):
    world.handle("/other").Subscriber("/b", Message, print)
    publisher = nh.Publisher("a", Message, queue_size=1)
    world.transport.on_register = lambda topic: join(in_thread(nh.context.close))
    world.bus.rewire([(publisher.publication, "/b")])
    assert world.registrations == [("subscriber", "/b")]
    with pytest.raises(HandleClosed):
        publisher.publish(1)


def test_a_handle_being_made_while_its_nodelet_is_unloaded_leaves_nothing(world, nh):
    world.transport.on_register = lambda topic: join(in_thread(nh.context.close))
    with pytest.raises(HandleClosed):
        nh.Publisher("a", Message, queue_size=1)
    assert world.registrations == []
