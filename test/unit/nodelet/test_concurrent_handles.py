# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Multi-threaded handles: subscriptions overlap, each keeps its order."""

from __future__ import annotations

import logging
import threading

import pytest
from unit.nodelet.fakes import (
    PATIENCE,
    Message,
    in_thread,
    join,
    numbers,
    pool_world,
    wait_for,
    wait_until,
)

from dyknow.nodelet.handle import PlainNodeHandle

world = pool_world(4)


def test_callbacks_of_two_subscriptions_overlap(world):
    nh = world.handle(concurrent=True)
    both, met = threading.Barrier(2), []

    def meet(message):
        both.wait(PATIENCE)
        met.append(message)

    nh.Subscriber("t", Message, meet)
    nh.Subscriber("t", Message, meet)
    nh.Publisher("t", Message).publish()
    world.drain()
    assert len(met) == 2


def test_a_subscription_overlaps_with_a_timer(world):
    nh = world.handle(concurrent=True)
    both, met = threading.Barrier(2), []

    def meet(event):
        both.wait(PATIENCE)
        met.append(event)

    nh.Subscriber("t", Message, meet)
    nh.Timer(1.0, meet, oneshot=True)
    nh.Publisher("t", Message).publish()
    world.ticker.advance(1.0)
    world.drain()
    wait_until(lambda: len(met) == 2)


def test_each_subscription_keeps_its_order_and_never_overlaps_itself(world):
    nh = world.handle(concurrent=True)
    got, inside, overlaps = [[], []], [0, 0], []

    def receive(message, which):
        inside[which] += 1
        if inside[which] > 1:
            overlaps.append(which)
        got[which].append(message.number)
        inside[which] -= 1

    for which in range(2):
        nh.Subscriber("t", Message, receive, which)
    publisher = nh.Publisher("t", Message)
    for number in range(3000):
        publisher.publish(number)
    world.drain()
    assert overlaps == []
    assert got == [list(range(3000))] * 2


def test_a_blocked_subscription_holds_up_no_other(world):
    nh = world.handle(concurrent=True)
    release, free = threading.Event(), threading.Event()
    nh.Subscriber("t", Message, lambda message: wait_for(release))
    nh.Subscriber("t", Message, lambda message: free.set())
    nh.Publisher("t", Message).publish()
    wait_for(free)
    release.set()


def test_an_unload_stops_all_of_them(world):
    nh = world.handle(concurrent=True)
    started, release, got = threading.Event(), threading.Event(), []

    def hang(message):
        started.set()
        wait_for(release)

    nh.Subscriber("t", Message, hang)
    nh.Subscriber("u", Message, got.append)
    hanging, other = nh.Publisher("t", Message), world.handle("/o").Publisher("/u", Message)
    hanging.publish(1)
    hanging.publish(2)
    wait_for(started)
    nh.context.close()
    other.publish()
    release.set()
    world.drain()
    assert got == []
    assert started.is_set()


def test_an_unregistered_subscriber_takes_its_strand_with_it(world, caplog):
    caplog.set_level(logging.INFO)
    nh = world.handle(concurrent=True)
    before = len(nh.context._strands)
    publisher = nh.Publisher("t", Message)
    for _ in range(20):
        done, subscribers = threading.Event(), []

        def once(message, done=done, subscribers=subscribers):
            subscribers[0].unregister()
            done.set()

        subscribers.append(nh.Subscriber("t", Message, once))
        publisher.publish()
        wait_for(done)
    world.drain()
    assert len(nh.context._strands) == before
    assert "unload" not in caplog.text, "nothing was unloaded"


def test_a_refused_subscriber_takes_its_strand_with_it(world):
    nh = world.handle(concurrent=True)
    before = len(nh.context._strands)
    world.transport.refused["/t"] = RuntimeError("no")
    with pytest.raises(RuntimeError):
        nh.Subscriber("t", Message, print)
    assert len(nh.context._strands) == before


def test_both_kinds_of_handles_of_one_nodelet_go_together(world):
    single, got = world.handle("/n"), []
    many = PlainNodeHandle(single.context, "/", concurrent=True)
    release = threading.Event()
    single.Subscriber("block", Message, lambda message: wait_for(release))
    seen = threading.Event()
    many.Subscriber("t", Message, lambda message: (got.append(message), seen.set()))
    publisher = single.Publisher("t", Message)
    single.Publisher("block", Message).publish()
    join(in_thread(lambda: publisher.publish(5)))
    wait_for(seen)
    assert numbers(got) == [5]
    release.set()
