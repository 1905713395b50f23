# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Registrations outside amid a switch: when they are made, fed, and withdrawn."""

from __future__ import annotations

from typing import Callable

import pytest
from clocks import in_thread, join
from unit.nodelet.fakes import Message, numbers
from unit.proxy.bench import Bench

from dyknow.errors import HandleClosed, UnloadedMeanwhile
from dyknow.nodelet.local import LocalSubscriber


class Draining(LocalSubscriber):
    """Calls a function when it is drained, and receives once more when it is closed."""

    on_drain: Callable[[], None]

    def drain(self, seconds):
        self.on_drain()
        super().drain(seconds)

    def close(self):
        self.receive(Message("late"))
        super().close()


class Ported(Bench):
    """A bench with an out-port on /a and an in-port on /x, and a further handle of each."""

    def __init__(self):
        super().__init__()
        self.got = []
        self.transport = self.world.transport
        self.out, self.spare = (
            self.nh.Publisher("out", Message, latch=True, queue_size=1) for _ in range(2)
        )
        self.nh.Subscriber("into", Message, self.got.append)
        self.connect(out="/a", into="/x")

    def drained_by(self, on_drain):
        (subscriber,) = self.transport.subscribers
        subscriber.__class__, subscriber.on_drain = Draining, on_drain
        return subscriber

    def received(self):
        self.world.drain()
        return numbers(self.got)


@pytest.fixture(name="bench")
def _bench():
    return Ported()


def test_a_new_connection_is_made_before_the_old_one_is_broken(bench):
    seen = []
    bench.transport.on_register = lambda topic: seen.append((topic, bench.world.registrations))
    bench.connect(out="/b", into="/y")
    both = [("publisher", "/a"), ("subscriber", "/x")]
    assert seen == [("/b", both), ("/y", sorted([*both, ("publisher", "/b")]))]


def test_messages_from_outside_that_come_during_the_switch_follow_the_old_ones(bench):
    bench.nh.set_reconfigure_callback(lambda *maps: bench.got.append(Message("between")))
    bench.transport.send("/x", Message("old"))

    class Early(LocalSubscriber):
        def wait(self, arrived, seconds):
            self.receive(Message("new"))
            assert arrived(0.0)

    bench.transport.on_made = lambda made: setattr(made, "__class__", Early)
    bench.connect(into="/new")
    assert bench.received() == ["old", "between", "new"]


def test_messages_until_the_switch_go_before_the_new_and_later_ones_are_dropped(bench):
    def last_words():
        bench.transport.send("/new", Message("new"))
        bench.transport.send("/x", Message("last"))

    old = bench.drained_by(last_words)
    bench.connect(into="/new")
    old.receive(Message("later still"))
    assert bench.received() == ["last", "new"]


@pytest.mark.parametrize("alive", [False, True])
def test_the_last_latched_message_stays_outside(bench, alive):
    if alive:  # so that the switch goes before the registration
        bench.probe.Subscriber("/new", Message, print)
    bench.out.publish(1)
    got = []

    def listen(message):
        got.append(message)
        if len(got) == 1:  # another thread publishes while the latched message is handed over
            bench.out.publish(2)
            got.append(message)

    bench.transport.listeners.setdefault("/new", []).append(listen)
    bench.connect(out="/new")
    assert numbers(got)[0] == 1
    assert numbers(got)[-1] == 2


def test_a_handle_that_goes_amid_the_switch_goes_alone(bench):
    bench.drained_by(lambda: join(in_thread(bench.spare.unregister)))
    bench.connect(out="/b", into="/y")
    assert bench.world.registrations == [("publisher", "/b"), ("subscriber", "/y")]
    bench.transport.send("/y", Message(1))
    assert bench.received() == [1]


@pytest.mark.parametrize("moment", ["waiting for peers", "last words", "registering"])
def test_a_nodelet_unloaded_amid_its_switch_leaves_nothing(bench, moment):
    seen, world = [], bench.world

    def unload(*args):
        seen.append(len(world.registrations))
        join(in_thread(bench.context.close))
        seen.append(len(world.registrations))

    def wait(*args):
        assert moment == "waiting for peers", "no peer is waited for after the unload"
        if not seen:
            unload()

    if moment == "last words":
        bench.drained_by(unload)
    else:
        world.transport.on_made = lambda made: setattr(made, "wait", wait)
    if moment == "registering":
        world.transport.on_register = unload
    with pytest.raises(UnloadedMeanwhile, match="/ns/nodelet"):
        bench.connect(into="/c", out="/b")
    assert seen == [2 if moment == "registering" else 4, 0]
    assert world.registrations == []
    assert world.bus._topics == {}


def test_a_nodelet_unloaded_while_a_live_topic_is_registered_leaves_nothing(bench):
    bench.probe.Subscriber("/b", Message, print)
    bench.transport.on_register = lambda topic: join(in_thread(bench.context.close))
    bench.connect(out="/b")
    assert bench.world.registrations == [("subscriber", "/b")]
    with pytest.raises(HandleClosed):
        bench.out.publish(1)
