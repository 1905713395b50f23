# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Workers that work in rounds, in time that the test moves on."""

from __future__ import annotations

import threading
from typing import Callable, Iterator, List

import pytest
from clocks import PATIENCE, SteppedClock

from dyknow.errors import DyKnowError
from dyknow.periodic import PAUSE, RETRY, Period, PeriodicWorker, attempt, in_background

Make = Callable[..., PeriodicWorker]


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


@pytest.fixture
def rounds() -> List[float]:
    """When each round was."""
    return []


@pytest.fixture
def make(clock: SteppedClock, rounds: List[float]) -> Iterator[Make]:
    made: List[PeriodicWorker] = []

    def build(
        period: Period = None, work: Callable[[], None] = lambda: None, pause: float = PAUSE
    ) -> PeriodicWorker:
        def round_() -> None:
            rounds.append(clock.now())
            work()

        worker = PeriodicWorker("testing", round_, period, pause, clock=clock)
        made.append(worker)
        worker.start()
        clock.settle()
        return worker

    yield build
    for each in made:
        each.close(PATIENCE)
        assert not each.running


def test_a_round_comes_after_each_period(
    make: Make, clock: SteppedClock, rounds: List[float]
) -> None:
    make(2.0)
    clock.advance(7.0)
    assert rounds == [2.0, 4.0, 6.0]


def test_the_period_may_differ_from_round_to_round(
    make: Make, clock: SteppedClock, rounds: List[float]
) -> None:
    periods = iter([1.0, 3.0, None, 0.5])
    make(lambda: next(periods))
    clock.advance(8.0)
    assert rounds == [1.0, 4.0], "and sleeps since"


def test_without_a_period_a_worker_sleeps_until_it_is_woken(
    make: Make, clock: SteppedClock, rounds: List[float]
) -> None:
    worker = make()
    clock.advance(1000.0)
    assert rounds == []
    assert worker.wait_for(worker.wake(), PATIENCE)
    assert rounds == [1000.0]


def test_a_storm_of_wakes_is_one_round_in_a_pause(
    make: Make, clock: SteppedClock, rounds: List[float]
) -> None:
    worker = make(pause=1.0)
    for _ in range(100):
        worker.wake()
    assert not rounds
    clock.advance(1.0)
    for _ in range(100):
        worker.wake()
    clock.advance(2.0)
    assert rounds == [1.0, 2.0]


def test_a_wake_during_a_round_asks_for_the_next_one(
    make: Make, clock: SteppedClock, rounds: List[float]
) -> None:
    going_on, go_on = threading.Event(), threading.Event()

    def work() -> None:
        going_on.set()
        assert go_on.wait(PATIENCE)

    worker = make(work=work, pause=0.0)
    first = worker.wake()
    assert going_on.wait(PATIENCE)
    second = worker.wake()
    assert second == first + 1
    assert not worker.wait_for(first, 0.0)
    go_on.set()
    assert worker.wait_for(second, PATIENCE)
    clock.settle()
    assert len(rounds) == 2


def test_a_wake_before_the_start_is_kept(clock: SteppedClock, rounds: List[float]) -> None:
    worker = PeriodicWorker("testing", lambda: rounds.append(clock.now()), pause=0.0, clock=clock)
    number = worker.wake()
    worker.start()
    worker.start()
    assert worker.wait_for(number, PATIENCE)
    worker.close(PATIENCE)
    assert len(rounds) == 1


@pytest.mark.parametrize("error", [DyKnowError("refused"), RuntimeError("unexpected")])
def test_a_round_that_fails_is_logged_and_repeated(
    make: Make,
    clock: SteppedClock,
    rounds: List[float],
    caplog: pytest.LogCaptureFixture,
    error: Exception,
) -> None:
    def work() -> None:
        if len(rounds) == 1:
            raise error

    make(10.0, work)
    clock.advance(10.0)
    clock.advance(RETRY + 2 * PAUSE)
    assert rounds == pytest.approx([10.0, 10.0 + RETRY + PAUSE])
    assert str(error) in caplog.text
    assert ("Traceback" in caplog.text) == (not isinstance(error, DyKnowError))


def test_a_period_that_fails_is_asked_again(
    make: Make, clock: SteppedClock, rounds: List[float]
) -> None:
    asked = []

    def period() -> float:
        asked.append(clock.now())
        if len(asked) == 1:
            raise RuntimeError("injected")
        return 5.0

    make(period)
    clock.advance(RETRY + 2 * PAUSE)
    assert rounds == pytest.approx([RETRY + PAUSE])


def test_a_worker_may_close_itself(clock: SteppedClock) -> None:
    worker = PeriodicWorker("testing", lambda: worker.close(PATIENCE), pause=0.0, clock=clock)
    worker.start()
    assert worker.wait_for(worker.wake(), PATIENCE)
    worker.close(PATIENCE)
    assert not worker.running


def test_close_waits_for_a_round_but_not_for_ever(make: Make) -> None:
    going_on, go_on = threading.Event(), threading.Event()

    def work() -> None:
        going_on.set()
        assert go_on.wait(PATIENCE)

    worker = make(work=work, pause=0.0)
    worker.wake()
    assert going_on.wait(PATIENCE)
    worker.close(0.01)
    assert worker.running
    go_on.set()
    worker.close(PATIENCE)
    assert not worker.running


def test_a_round_that_runs_at_the_close_is_waited_for(make: Make) -> None:
    going_on, go_on = threading.Event(), threading.Event()

    def work() -> None:
        going_on.set()
        assert go_on.wait(PATIENCE)

    worker = make(work=work, pause=0.0)
    number = worker.wake()
    assert going_on.wait(PATIENCE)
    later = worker.wake()
    worker.close()
    answers: List[bool] = []
    waiter = in_background("waiting", lambda: answers.append(worker.wait_for(number, PATIENCE)))
    waiter.join(0.1)
    go_on.set()
    waiter.join(PATIENCE)
    assert answers == [True]
    assert not worker.wait_for(later, PATIENCE), "no round begins after the close"


def test_who_waits_for_a_round_is_let_go_at_the_end(make: Make) -> None:
    worker = make()
    waiter = in_background("waiting", lambda: worker.wait_for(7, PATIENCE))
    worker.close(PATIENCE)
    waiter.join(PATIENCE / 2)
    assert not waiter.is_alive()
    assert not worker.wait_for(7, PATIENCE)


def test_a_closed_worker_does_not_start(clock: SteppedClock) -> None:
    worker = PeriodicWorker("testing", lambda: None, clock=clock)
    worker.close()
    worker.start()
    assert not worker.running


def test_what_fails_in_the_background_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    in_background("dividing", lambda: 1 // 0).join(PATIENCE)
    assert "dividing failed" in caplog.text
    assert "ZeroDivisionError" in caplog.text


def test_an_attempt_returns_what_the_work_does() -> None:
    assert attempt("counting", lambda: 3) == 3
    assert attempt("dividing", lambda: 1 // 0) is None
