# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Loops, workers and pools, in time that the test moves on."""

from __future__ import annotations

import gc
import sys
import threading
from typing import Callable, Iterator, List, Optional

import pytest
from clocks import PATIENCE, Gate, HandClock, SteppedClock, join, wait_for

from dyknow.errors import DyKnowError
from dyknow.periodic import (
    PAUSE,
    RETRY,
    ControlLoop,
    EventQueue,
    PeriodicWorker,
    Workers,
    attempt,
    current_frames,
    in_background,
)


class Bench:
    """A loop without threads, and when the rounds of its keys were."""

    def __init__(self) -> None:
        self.clock = HandClock()
        self.loop = ControlLoop(clock=self.clock)
        self.rounds: List[float] = []

    def add(
        self, after: Optional[float], work: Callable[[], Optional[float]], pause: float = PAUSE
    ) -> None:
        def round_() -> Optional[float]:
            self.rounds.append(self.clock.time)
            return work()

        self.loop.add("key", round_, after, pause)

    def advance(self, until: float) -> None:
        for moment in self.loop.advance(until):
            self.clock.time = moment
        self.clock.time = until


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize(
    ("periods", "rounds"),
    [([2.0] * 3, [2.0, 4.0, 6.0]), ([1.0, 3.0, None, 0.5], [1.0, 4.0]), ([None], [])],
)
def test_a_round_says_when_the_next_one_comes(
    bench: Bench, periods: List[Optional[float]], rounds: List[float]
) -> None:
    each = iter(periods)
    bench.add(next(each), lambda: next(each, None))
    bench.advance(1000.0)
    assert bench.rounds == rounds


def test_a_storm_of_wakes_is_one_round_in_a_pause(bench: Bench) -> None:
    bench.add(None, lambda: None, pause=1.0)
    for _ in range(2):
        for _ in range(100):
            bench.loop.wake("key")
        bench.advance(bench.clock.time + 1.0)
    bench.advance(1000.0)
    assert bench.rounds == [1.0, 2.0]


def test_a_wake_during_a_round_asks_for_the_next_one(bench: Bench) -> None:
    numbers: List[int] = []

    def work() -> None:
        if not numbers:
            numbers.append(bench.loop.wake("key"))
            assert not bench.loop.wait_for("key", numbers[0] - 1, 0.0), "it has not ended"

    bench.add(0.0, work)
    bench.advance(PAUSE)
    assert not bench.loop.wait_for("key", numbers[0], 0.0)
    bench.advance(10.0)
    assert bench.loop.wait_for("key", numbers[0], 0.0)
    assert len(bench.rounds) == 2


def test_a_wake_before_its_key_is_added_does_nothing(bench: Bench) -> None:
    bench.loop.wake("key")
    bench.add(None, lambda: None)
    bench.advance(10.0)
    assert not bench.rounds


@pytest.mark.parametrize("error", [DyKnowError("refused"), RuntimeError("unexpected")])
def test_a_round_that_fails_is_logged_and_repeated(
    bench: Bench, caplog: pytest.LogCaptureFixture, error: Exception
) -> None:
    def work() -> None:
        bench.loop.wake("key")
        if len(bench.rounds) == 1:
            raise error
        bench.loop.close()

    bench.add(10.0, work)
    bench.advance(100.0)
    assert bench.rounds == [10.0, 10.0 + RETRY]
    assert str(error) in caplog.text
    assert ("Traceback" in caplog.text) == (not isinstance(error, DyKnowError))


def test_a_key_that_waits_already_is_not_added_again(bench: Bench) -> None:
    done: List[str] = []
    bench.loop.once("a", lambda: done.append("a"))
    bench.loop.once("b", lambda: bench.loop.once("b", lambda: done.append("never")))
    bench.loop.once("a", lambda: done.append("never"))
    bench.advance(1.0)
    bench.loop.once("a", lambda: done.append("again"))
    bench.advance(2.0)
    assert done == ["a", "again"]


@pytest.fixture
def gate() -> Iterator[Gate]:
    made = Gate()
    yield made
    made.open()


def test_slow_rounds_hold_up_no_other_key(gate: Gate) -> None:
    loop = ControlLoop(workers=1)
    done = threading.Event()
    loop.add("slow", gate, 0.0)  # type: ignore[arg-type]
    loop.start()
    for number in range(3):
        loop.once(f"restoring {number}", gate)
    loop.add("late", done.set, 0.0)  # type: ignore[arg-type]
    wait_for(done)
    loop.close()


def test_what_happens_wakes_one_thread_and_not_all() -> None:
    waits: List[float] = []

    class CountingClock(SteppedClock):
        def wait(self, condition: threading.Condition, seconds: Optional[float]) -> None:
            waits.append(self.now())
            super().wait(condition, seconds)

    clock = CountingClock()
    loop = ControlLoop(20, clock)
    loop.add("key", lambda: 1.0, after=1.0)
    loop.start()
    clock.settle(21)
    del waits[:]
    clock.advance(100.0, 21)
    loop.close(PATIENCE)
    assert 100 <= len(waits) <= 400  # the watch is handed on, and both threads wait again


def test_a_worker_works_periodically_until_it_is_closed() -> None:
    clock = SteppedClock()
    rounds: List[float] = []
    worker = PeriodicWorker("testing", lambda: rounds.append(clock.now()), 2.0, clock=clock)
    worker.start()
    worker.start()
    clock.advance(5.0)
    assert rounds == [2.0, 4.0]
    worker.close(PATIENCE)
    assert not worker.wait_for(worker.wake(), 0.0)


def test_a_wake_before_the_start_is_kept() -> None:
    worker = PeriodicWorker("testing", lambda: None, pause=0.0)
    number = worker.wake()
    worker.start()
    assert worker.wait_for(number, PATIENCE)
    worker.close(PATIENCE)


def test_a_worker_may_close_itself() -> None:
    worker = PeriodicWorker("testing", lambda: worker.close(PATIENCE), pause=0.0)
    worker.start()
    assert worker.wait_for(worker.wake(), PATIENCE)


def test_a_round_that_runs_at_the_close_is_waited_for(gate: Gate) -> None:
    worker = PeriodicWorker("testing", gate, pause=0.0)
    worker.start()
    number = worker.wake()
    wait_for(gate.begun)
    later = worker.wake()
    worker.close(0.01)
    answers: List[bool] = []
    waiter = in_background("waiting", lambda: answers.append(worker.wait_for(number, PATIENCE)))
    waiter.join(0.1)
    gate.open()
    join(waiter)
    assert answers == [True]
    assert not worker.wait_for(later, PATIENCE), "no round begins after the close"


def test_a_close_ends_the_wait_for_a_round_that_will_not_come() -> None:
    worker = PeriodicWorker("testing", lambda: None)
    waiter = in_background("waiting", lambda: worker.wait_for(7, PATIENCE))
    worker.close()
    worker.start()
    waiter.join(PATIENCE / 2)  # sooner than it would give up
    assert not waiter.is_alive()


def test_one_worker_of_a_pool_keeps_the_order() -> None:
    workers = Workers("testing", 1)
    done: List[int] = []
    over = threading.Event()
    for number in range(100):
        workers.run(lambda number=number: done.append(number))
    workers.run(over.set)
    wait_for(over)
    workers.close(PATIENCE)
    assert done == list(range(100))


def test_a_pool_works_on_as_much_as_it_has_threads(caplog: pytest.LogCaptureFixture) -> None:
    workers = Workers("testing", 3)
    together = threading.Barrier(4)
    workers.run(lambda: 1 // 0)
    for _ in range(3):
        workers.run(lambda: together.wait(PATIENCE))
    together.wait(PATIENCE)
    workers.close(PATIENCE)
    assert "ZeroDivisionError" in caplog.text


def test_a_pool_that_is_closed_begins_nothing_more_and_ends_running_work(gate: Gate) -> None:
    workers = Workers("testing", 1)
    done: List[str] = []
    workers.run(lambda: (gate(), done.append("begun")))
    workers.run(lambda: done.append("not begun"))
    wait_for(gate.begun)
    workers.close(0.01)
    assert done == []
    gate.open()
    workers.close(PATIENCE)
    assert done == ["begun"]


def test_work_that_fails_in_the_background_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    in_background("dividing", lambda: 1 // 0).join(PATIENCE)
    assert "dividing failed" in caplog.text
    assert attempt("counting", lambda: 3) == 3
    assert attempt("dividing", lambda: 1 // 0) is None


def test_an_error_of_a_listener_is_logged_and_the_next_events_come(
    caplog: pytest.LogCaptureFixture,
) -> None:
    heard: List[int] = []

    def listener(event: int) -> None:
        heard.append(event)
        if event == 1:
            events.add(3)
            raise ValueError("a mistake of the user")

    events = EventQueue(listener)
    events.add(1)
    events.add(2)
    events.deliver()
    assert heard == [1, 2, 3]
    assert "a mistake of the user" in caplog.text


@pytest.mark.parametrize("is_enabled", [True, False])
def test_nothing_is_collected_while_frames_are_looked_up(monkeypatch, is_enabled):
    monkeypatch.setattr(sys, "_current_frames", lambda: {1: gc.isenabled()})
    was_enabled = gc.isenabled()
    try:
        (gc.enable if is_enabled else gc.disable)()
        assert current_frames() == {1: False}
        assert gc.isenabled() is is_enabled
    finally:
        (gc.enable if was_enabled else gc.disable)()


def test_the_frames_of_all_threads():
    assert current_frames()[threading.get_ident()].f_code.co_name == "current_frames"
