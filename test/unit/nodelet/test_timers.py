# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Timers on time that stands still until the test moves it."""

from __future__ import annotations

import gc
import threading

import pytest
from clocks import PATIENCE, eventually
from unit.nodelet.fakes import FakeClock, World, make_pool_world

from dyknow.nodelet.timers import TimerQueue


class StillQueue(TimerQueue):
    """A timer queue without its thread: the test ticks."""

    def _run(self):
        pass


@pytest.fixture(name="world")
def _world():
    world = World()
    object.__setattr__(world.runtime, "timers", StillQueue(world.ticker))
    return world


def tick_at(world, seconds):
    """Let time pass, and have the due timers queue their callbacks."""
    world.ticker.advance(seconds)
    world.runtime.timers.tick()


def advance(world, seconds):
    tick_at(world, seconds)
    world.drain()
    for _ in range(2):  # as the thread does, which looks again when something is due already
        tick_at(world, 0.0)
        world.drain()


def every_second(world, **options):
    """The moments at which a timer with a period of one second has fired."""
    fired = []
    world.handle().Timer(1.0, lambda event: fired.append(event.current_real), **options)
    return fired


@pytest.mark.parametrize(
    ("steps", "moments"),
    [
        ([0.5] * 7, [1.0, 2.0, 3.0]),
        ([5.5, 0.5], [5.5, 6.0]),  # no burst after a sleep, and the grid is kept
        ([100.0, -99.5, 0.75, 0.25, 1.0], [100.0, 1.5, 2.5]),  # a jump back: one period later
    ],
)
def test_a_timer_fires_once_each_period(world, steps, moments):
    fired = every_second(world)
    for seconds in steps:
        advance(world, seconds)
    assert fired == moments


def test_a_timer_that_is_made_just_before_a_jump_back_does_not_wait_for_the_old_future(world):
    advance(world, 1.0)
    world.ticker.advance(99.0)
    fired = every_second(world)
    world.ticker.advance(-98.0)  # the queue has not seen any of it
    advance(world, 0.0)
    advance(world, 1.0)
    assert fired == [3.0]


def test_the_event_has_the_facts_of_rospys(world):
    events = []
    world.executor.clock = FakeClock()
    world.handle().Timer(1.0, events.append)
    advance(world, 1.25)
    advance(world, 1.0)
    first, second = events
    assert (first.last_expected, first.last_real, first.last_duration) == (None, None, None)
    assert (first.current_expected, first.current_real) == (1.0, 1.25)
    assert (second.last_expected, second.last_real) == (1.0, 1.25)
    assert (second.current_expected, second.current_real) == (2.0, 2.25)
    assert second.last_duration == 0.0


def test_calls_due_while_the_nodelet_is_busy_are_one_and_made_after_it(world):
    fired = []
    clock = world.executor.clock = FakeClock()

    def slow(event):
        fired.append(event)
        if len(fired) == 1:
            clock.seconds += 0.25
            for _ in range(5):
                tick_at(world, 1.0)

    world.handle().Timer(1.0, slow)
    tick_at(world, 1.0)
    tick_at(world, 1.0)
    world.drain()
    assert [event.current_real for event in fired] == [2.0, 7.0]
    assert fired[1].last_duration == 0.25, "as in rospy, it is not of simulated time"


def test_the_time_of_each_call_counts_though_its_timer_has_ended(world):
    nh, busy = world.handle(), [0.0]

    def chained(event):
        nh.Timer(1.0, chained, oneshot=True)
        busy.append(nh.context.busy())

    nh.Timer(1.0, chained, oneshot=True)
    for _ in range(3):
        advance(world, 1.0)
    assert busy[:2] == [0.0, 0.0]
    assert 0.0 < busy[2] < busy[3] < nh.context.busy()


@pytest.mark.parametrize("how", ["oneshot", "in its callback", "while a call waits", "unload"])
def test_the_end_of_a_timer(world, how):
    fired, made, nh = [], [], world.handle("/going")

    def fire(event):
        fired.append(event)
        if how == "in its callback":
            made[0].shutdown()

    made.append(nh.Timer(1.0, fire, oneshot=how == "oneshot"))
    staying = every_second(world)
    assert made[0].is_alive()
    tick_at(world, 1.0)
    if how == "while a call waits":
        made[0].shutdown()
    elif how == "unload":
        nh.context.close()
        made.append(nh.Timer(1.0, fire))  # by a nodelet that is gone
    advance(world, 0.0)
    for _ in range(3):
        advance(world, 1.0)
    assert len(fired) == (1 if how in ("oneshot", "in its callback") else 0)
    assert not any(timer.is_alive() for timer in made)
    assert staying == [1.0, 2.0, 3.0, 4.0]
    assert len(world.runtime.timers._heap) == 1


def test_a_failing_callback_is_counted_and_called_again(world, caplog):
    handle, fired = world.handle("/failing"), []

    def fail(event):
        fired.append(event)
        raise SystemExit("no")

    handle.Timer(1.0, fail)
    advance(world, 1.0)
    advance(world, 1.0)
    assert len(fired) == handle.context.callback_errors == 2
    assert "/failing: the callback of a timer raised" in caplog.text


@pytest.mark.parametrize("period", [0.0, -1.0, float("nan")])
def test_a_period_must_be_positive(world, period):
    with pytest.raises(ValueError, match="must be positive"):
        world.handle().Timer(period, print)


def test_finished_timers_leave_nothing_behind(world):
    # A common pattern: a callback that makes a one-shot timer, again and again.
    handle = world.handle(concurrent=True)
    before = len(world.executor.strands)
    for _ in range(50):
        handle.Timer(1.0, lambda event: None, oneshot=True)
        advance(world, 1.0)
        handle.Timer(1.0, lambda event: None).shutdown()
    gc.collect()
    assert len(world.executor.strands) <= before + 2
    assert len(world.runtime.timers._heap) == 0


def test_the_thread_sleeps_until_something_is_due_outlives_a_failing_ticker_and_ends(caplog):
    world = make_pool_world(1)
    fired, calls, wait = threading.Semaphore(0), [], world.ticker.wait

    def failing_wait(until):
        calls.append(until)
        if len(calls) == 1:
            raise RuntimeError("clock lost")
        wait(until)

    world.ticker.wait = failing_wait  # type: ignore[method-assign]
    try:
        world.handle().Timer(10.0, lambda event: fired.release())
        world.handle("/sooner").Timer(1.0, lambda event: fired.release())
        eventually(lambda: len(calls) > 1)
        for _ in range(10):
            world.ticker.advance(1.0)
            assert fired.acquire(timeout=PATIENCE)
        assert fired.acquire(timeout=PATIENCE)
        assert "clock lost" in caplog.text
    finally:
        world.close()
    eventually(lambda: not world.runtime.timers._thread.is_alive())


def test_timers_that_are_due_shortly_after_each_other_are_fired_together(world):
    for number in range(10):
        world.handle(f"/n{number}").Timer(0.1 + number * 1e-4, lambda event: None)
    queue = world.runtime.timers
    assert queue.tick() == pytest.approx(0.1), "the first is not late"
    world.ticker.advance(0.1)
    assert queue.tick() == pytest.approx(0.102), "the others are late by two milliseconds"
    fast = world.handle("/fast").Timer(0.0005, lambda event: None)
    assert queue.tick() == pytest.approx(0.1001), "every call of a fast one is due"
    fast.shutdown()
    assert queue.tick() == pytest.approx(0.102)
