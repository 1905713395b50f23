# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Strands: order, exclusion, holding and killing, on an executor that is stepped by hand."""

from __future__ import annotations

import collections
import gc
import logging
import threading

from dyknow.nodelet.scheduler import ManualExecutor, Strand


def test_tasks_run_in_the_order_they_were_posted():
    executor, ran = ManualExecutor(), []
    strand = Strand(executor, "s")
    for number in range(100):
        strand.post(lambda number=number: ran.append(number))
    executor.drain()
    assert ran == list(range(100))


def test_nothing_runs_before_the_executor_is_asked():
    executor, ran = ManualExecutor(), []
    Strand(executor, "s").post(lambda: ran.append(1))
    assert ran == []
    assert executor.step() is True
    assert ran == [1]
    assert executor.step() is False


def test_a_task_posted_by_a_task_runs_after_it_and_not_inside_it():
    executor, ran = ManualExecutor(), []
    strand = Strand(executor, "s")

    def outer() -> None:
        strand.post(lambda: ran.append("inner"))
        ran.append("outer")

    strand.post(outer)
    executor.drain()
    assert ran == ["outer", "inner"]


def test_a_busy_strand_lets_others_in_between():
    executor, ran = ManualExecutor(), []
    greedy, modest = Strand(executor, "greedy"), Strand(executor, "modest")

    def again() -> None:
        ran.append("greedy")
        if len(ran) < 1000:
            greedy.post(again)

    greedy.post(again)
    modest.post(lambda: ran.append("modest"))
    executor.drain()
    assert ran.index("modest") < 100


def test_a_held_strand_collects_until_it_is_resumed():
    executor, ran = ManualExecutor(), []
    strand = Strand(executor, "s", held=True)
    strand.post(lambda: ran.append(1))
    strand.post(lambda: ran.append(2))
    executor.drain()
    assert ran == []
    strand.resume()
    strand.post(lambda: ran.append(3))
    executor.drain()
    assert ran == [1, 2, 3]
    assert not strand.busy


def test_resuming_twice_is_resuming_once():
    executor, ran = ManualExecutor(), []
    strand = Strand(executor, "s", held=True)
    strand.post(lambda: ran.append(1))
    strand.resume()
    strand.resume()
    assert executor.step() is True
    assert executor.step() is False
    assert ran == [1]


def test_a_resumed_strand_without_tasks_takes_later_ones():
    executor, ran = ManualExecutor(), []
    strand = Strand(executor, "s", held=True)
    strand.resume()
    executor.drain()
    strand.post(lambda: ran.append(1))
    executor.drain()
    assert ran == [1]


def test_a_killed_strand_drops_what_waits_and_what_comes():
    executor, ran = ManualExecutor(), []
    strand = Strand(executor, "s")
    strand.post(lambda: ran.append(1))
    strand.kill()
    strand.post(lambda: ran.append(2))
    executor.drain()
    assert ran == []
    assert not strand.busy


def test_a_task_that_kills_its_own_strand_is_the_last():
    executor, ran = ManualExecutor(), []
    strand = Strand(executor, "s")
    strand.post(lambda: (ran.append(1), strand.kill()))
    strand.post(lambda: ran.append(2))
    executor.drain()
    assert ran == [1]


def test_a_strand_killed_while_held_never_runs():
    executor, ran = ManualExecutor(), []
    strand = Strand(executor, "s", held=True)
    strand.post(lambda: ran.append(1))
    strand.kill()
    strand.resume()
    executor.drain()
    assert ran == []


def test_a_task_that_exits_the_interpreter_ends_only_itself(caplog):
    executor, ran = ManualExecutor(), []
    strand = Strand(executor, "culprit")

    def leave() -> None:
        raise SystemExit(1)

    def interrupt() -> None:
        raise KeyboardInterrupt

    for task in (leave, interrupt, lambda: ran.append(1)):
        strand.post(task)
    executor.drain()
    assert ran == [1]
    assert caplog.text.count("culprit: a task failed") == 2
    assert "SystemExit" in caplog.text


def test_the_end_of_a_callback_that_outlived_its_strand_is_noted_once(caplog):
    executor = ManualExecutor()
    strand = Strand(executor, "/late")
    caplog.set_level(logging.INFO)
    strand.post(lambda: (strand.kill(log_end=True), strand.kill(log_end=True)))
    strand.post(lambda: None)
    executor.drain()
    assert [r.getMessage() for r in caplog.records] == [
        "/late: the callback that ran at the unload has ended"
    ]


def test_nothing_is_noted_of_a_strand_that_ran_nothing_when_it_was_killed(caplog):
    executor = ManualExecutor()
    caplog.set_level(logging.INFO)
    queued = Strand(executor, "/queued")
    queued.post(lambda: None)
    queued.kill(log_end=True)
    held = Strand(executor, "/held", held=True)
    held.kill(log_end=True)
    held.resume()
    executor.drain()
    assert caplog.records == []


def test_a_task_that_comes_while_the_strand_lets_go_is_not_forgotten():
    # The critical moment: the strand has found its queue empty and is still busy.
    executor, ran = ManualExecutor(), []
    strand = Strand(executor, "s")
    guest = threading.Thread(target=lambda: strand.post(lambda: ran.append("late")))

    class Door(collections.deque):
        def __len__(self):
            if ran and guest.ident is None:
                guest.start()
                guest.join(0.05)
                assert guest.is_alive(), "who posts now has to wait"
            return super().__len__()

        def __bool__(self):  # Python 3.8 asks the deque of C otherwise
            return len(self) > 0

    strand._tasks = Door()
    strand.post(lambda: ran.append("first"))
    executor.drain()
    guest.join(10.0)
    executor.drain()
    assert ran == ["first", "late"]
    assert not strand.busy


def test_an_executor_keeps_no_strand_alive():
    executor = ManualExecutor()
    strand = Strand(executor, "s")
    strand.post(lambda: None)
    executor.drain()
    assert len(executor.strands) == 1
    del strand
    gc.collect()
    assert len(executor.strands) == 0
