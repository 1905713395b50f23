# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Strands: order, exclusion, holding and killing, on an executor that is stepped by hand."""

from __future__ import annotations

import collections
import gc
import logging
import threading

import pytest

from dyknow.nodelet.scheduler import ManualExecutor, Strand


class Bench:
    """A strand whose tasks record that they ran."""

    def __init__(self, held=False):
        self.executor, self.ran = ManualExecutor(), []
        self.strand = Strand(self.executor, "culprit", held)
        self.drain = self.executor.drain

    def post(self, *names):
        for name in names:
            self.strand.post(lambda name=name: self.ran.append(name))


@pytest.fixture(name="bench")
def _bench():
    return Bench()


@pytest.fixture(name="held")
def _held():
    return Bench(held=True)


def test_tasks_run_when_the_executor_steps_in_the_order_they_were_posted(bench):
    bench.post(*range(100))
    bench.strand.post(lambda: (bench.post("inner"), bench.ran.append("outer")))
    assert bench.ran == []
    assert bench.executor.step() is True
    assert bench.ran == [0]
    bench.drain()
    assert bench.ran == [*range(100), "outer", "inner"]
    assert bench.executor.step() is False


def test_a_busy_strand_lets_others_in_between(bench):
    modest = Strand(bench.executor, "modest")

    def again():
        bench.ran.append("greedy")
        if len(bench.ran) < 1000:
            bench.strand.post(again)

    bench.strand.post(again)
    modest.post(lambda: bench.ran.append("modest"))
    bench.drain()
    assert bench.ran.index("modest") < 100


@pytest.mark.parametrize("before", [[], [1, 2]])
def test_a_held_strand_collects_until_it_is_resumed_once(held, before):
    held.post(*before)
    held.drain()
    assert held.ran == []
    held.strand.resume()
    held.strand.resume()
    held.post(3)
    held.drain()
    assert held.ran == [*before, 3]
    assert not held.strand.busy


def test_a_killed_strand_drops_queued_and_later_tasks_without_a_word(bench, held, caplog):
    caplog.set_level(logging.INFO)
    for each in (bench, held):
        each.post(1)
        each.strand.kill(log_end=True)
        each.post(2)
        each.strand.resume()
        each.drain()
        assert each.ran == []
        assert not each.strand.busy
    assert caplog.records == []


def test_a_task_that_kills_its_own_strand_is_the_last_and_its_end_is_logged_once(bench, caplog):
    caplog.set_level(logging.INFO)
    kill = bench.strand.kill
    bench.strand.post(lambda: (kill(log_end=True), kill(log_end=True)))
    bench.post(1)
    bench.drain()
    assert bench.ran == []
    assert [r.getMessage() for r in caplog.records] == [
        "culprit: the callback that ran at the unload has ended"
    ]


@pytest.mark.parametrize("error", [SystemExit(1), KeyboardInterrupt(), ValueError()])
def test_a_task_that_raises_ends_only_itself(bench, caplog, error):
    def leave():
        raise error

    bench.strand.post(leave)
    bench.post(1)
    bench.drain()
    assert bench.ran == [1]
    assert caplog.text.count("culprit: a task failed") == 1
    assert type(error).__name__ in caplog.text


def test_a_task_that_comes_while_the_strand_becomes_idle_is_not_forgotten(bench):
    # The critical moment: the strand has found its queue empty and is still busy.
    ran = bench.ran
    guest = threading.Thread(target=lambda: bench.post("late"))

    class Door(collections.deque):
        def __len__(self):
            if ran and guest.ident is None:
                guest.start()
                guest.join(0.05)
                assert guest.is_alive(), "a thread that posts now has to wait"
            return super().__len__()

        def __bool__(self):  # Python 3.8 asks the deque of C otherwise
            return len(self) > 0

    bench.strand._tasks = Door()
    bench.post("first")
    bench.drain()
    guest.join(10.0)
    bench.drain()
    assert ran == ["first", "late"]
    assert not bench.strand.busy


def test_an_executor_keeps_no_strand_alive():
    executor = ManualExecutor()
    strand = Strand(executor, "s")
    strand.post(lambda: None)
    executor.drain()
    assert len(executor.strands) == 1
    del strand
    gc.collect()
    assert len(executor.strands) == 0
