# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Worker pools: real threads, exclusion, lost wake-ups, growth, the watchdog."""

from __future__ import annotations

import functools
import logging
import threading

import pytest
from clocks import PATIENCE, eventually, in_thread, join, wait_for

from dyknow.nodelet.scheduler import Strand, WorkerPool


@pytest.fixture(name="make_pool")
def _make_pool():
    pools = []

    def make(size, **options):
        pools.append(WorkerPool(size, **options))
        return pools[-1]

    yield make
    for pool in pools:
        pool.close()


@pytest.fixture(name="pool", params=[3, None], ids=["fixed", "growing"])
def _pool(request, make_pool):
    return make_pool(request.param)


class Blocker:
    """Tasks that block until released."""

    def __init__(self, pool=None):
        self.started = threading.Semaphore(0)
        self.release = threading.Event()
        if pool is not None:
            self.strand = Strand(pool, "/blocked")
            self.strand.post(self)
            self.wait_started()

    def __call__(self):
        self.started.release()
        wait_for(self.release)

    def wait_started(self, count=1):
        for _ in range(count):
            assert self.started.acquire(timeout=PATIENCE)


class Clock:
    """Time that a test sets; counts its readings, as the watchdog takes one at each look."""

    def __init__(self):
        self.seconds = 100.0
        self._reads = threading.Semaphore(0)

    def __call__(self):
        self._reads.release()
        return self.seconds

    def wait_read(self, times):
        for _ in range(times):
            assert self._reads.acquire(timeout=PATIENCE)


def run_on(strand):
    """Have a strand run something, and wait for it."""
    ran = threading.Event()
    strand.post(ran.set)
    wait_for(ran)


def test_tasks_of_a_strand_run_all_alone_and_in_order(pool):
    # Strands run empty all the time here, and only then could a wake-up be missed.
    strands = [Strand(pool, str(n)) for n in range(4)]
    ran, inside = [[] for _ in strands], [0] * 4

    def task(which, poster, number):
        inside[which] += 1
        ran[which].append((poster, number, inside[which]))
        inside[which] -= 1

    def post(poster):
        for number in range(2000):
            which = (number + poster) % 4
            strands[which].post(functools.partial(task, which, poster, number))

    join(*[in_thread(lambda p=p: post(p)) for p in range(4)])
    assert pool.drain(PATIENCE), "a strand with tasks was forgotten"
    for which, tasks in enumerate(ran):
        for poster in range(4):
            expected = [(poster, n, 1) for n in range(2000) if (n + poster) % 4 == which]
            assert [each for each in tasks if each[0] == poster] == expected


def test_a_task_is_run_though_nothing_follows_it(pool):
    # One task at a time, each awaited: a lost wake-up would show as a time-out at once.
    strand, ran = Strand(pool, "s"), threading.Semaphore(0)
    for _ in range(1000):
        strand.post(ran.release)
        assert ran.acquire(timeout=PATIENCE)


def test_exiting_tasks_do_not_end_workers(make_pool):
    pool = make_pool(1)
    strand = Strand(pool, "s")

    def leave():
        raise SystemExit

    for _ in range(5):
        strand.post(leave)
    run_on(strand)
    assert pool.threads == 1


def test_drain_waits_for_a_running_task_unless_its_strand_was_killed(pool):
    for kill in (False, True):
        blocker = Blocker(pool)
        assert pool.drain(0.0) is False
        if kill:
            blocker.strand.kill()
            assert pool.drain(PATIENCE) is True
        blocker.release.set()
        assert pool.drain(PATIENCE) is True


def test_a_blocked_worker_is_replaced_and_ends_when_its_callback_returns(make_pool):
    pool = make_pool(2)
    blockers = [Blocker(pool) for _ in range(3)]  # the third starts on a new worker
    live = [Strand(pool, f"live {n}") for n in range(20)]
    for strand in live:
        run_on(strand)
    assert pool.threads > 3
    draining = in_thread(lambda: pool.drain(3 * PATIENCE))
    eventually(lambda: pool._drainers)
    for blocker in blockers:
        blocker.release.set()
    join(draining)
    run_on(blockers[0].strand)
    eventually(lambda: pool.threads == 2)


def test_workers_that_block_while_no_task_waits_are_kept(make_pool):
    clock = Clock()
    pool = make_pool(1, clock=clock)
    blocker = Blocker(pool)
    clock.wait_read(1)
    clock.seconds += 5.0
    clock.wait_read(3)
    assert pool.threads == 1
    blocker.release.set()


def test_a_stuck_callback_is_reported_once_with_its_stack(make_pool, caplog):
    clock = Clock()
    caplog.set_level(logging.WARNING)
    first = Blocker(make_pool(1, stuck_after=5.0, clock=clock))
    clock.wait_read(3)
    assert caplog.text == ""
    clock.seconds += 6.0
    eventually(lambda: "/blocked" in caplog.text)
    clock.wait_read(3)
    assert caplog.text.count("has not returned") == 1
    assert "in __call__" in caplog.text
    # The next callback of the same strand that hangs is a new fault, and is reported again.
    second = Blocker()
    first.strand.post(second)
    first.release.set()
    second.wait_started()
    clock.seconds += 14.0
    eventually(lambda: caplog.text.count("has not returned") == 2)
    second.release.set()


def test_the_watchdog_sleeps_while_there_is_nothing_to_do(make_pool):
    reads = []
    pool = make_pool(1, clock=lambda: reads.append(1) or float(len(reads)))
    strand = Strand(pool, "s")
    run_on(strand)
    eventually(lambda: not pool._awake.is_set())
    before = len(reads)
    # Three times the watchdog's period, in which it must not look once.
    threading.Event().wait(0.7)
    assert len(reads) == before
    # And it is there again when it is needed.
    blocker = Blocker(pool)
    run_on(strand)
    blocker.release.set()


def test_blocked_callbacks_of_a_growing_pool_hold_up_no_other(make_pool):
    pool = make_pool(None)
    blockers = [Blocker(pool) for _ in range(20)]
    assert pool.threads == 20
    for blocker in blockers:
        blocker.release.set()
    assert pool.drain(PATIENCE)


def test_threads_of_a_growing_pool_are_used_again_and_leave_without_work(make_pool):
    pool = make_pool(None, stay=PATIENCE)
    strand, threads = Strand(pool, "s"), set()
    for _ in range(10):
        strand.post(lambda: threads.add(threading.current_thread()))
        assert pool.drain(PATIENCE)
    assert len(threads) <= 3
    pool = make_pool(None, stay=0.01)
    strand = Strand(pool, "s")
    run_on(strand)
    eventually(lambda: pool.threads == 0)
    run_on(strand)


def test_a_closed_pool_runs_nothing_more_and_ends_its_threads(pool):
    blocker = Blocker(pool)
    pool.close()
    eventually(lambda: pool.threads == 1)
    blocker.release.set()
    eventually(lambda: pool.threads == 0)
    seen = []
    strand = Strand(pool, "s")
    strand.post(lambda: seen.append(1))
    assert not pool.drain(0.05) and seen == []


def test_a_growing_pool_that_gets_no_thread_runs_everything_once_it_gets_one(
    make_pool, limit, caplog
):
    pool = make_pool(None, stay=0.01)
    strands, ran = [Strand(pool, f"s{n}") for n in range(3)], threading.Semaphore(0)
    for _ in range(2):  # shortages
        limit.refuse("dyknow-worker")
        for strand in strands:
            strand.post(ran.release)
        for _ in range(3):
            pool.catch_up()
        assert (pool.threads, pool._woken) == (0, 0)
        assert not ran.acquire(blocking=False)
        limit.refuse("")
        pool.catch_up()
        for _ in strands:
            assert ran.acquire(timeout=PATIENCE)
        pool.catch_up()
        eventually(lambda: pool.threads == 0)
        assert pool._woken == 0
    assert caplog.text.count("no thread can be started for callbacks") == 2
    assert "can't start new thread" in caplog.text


def test_the_next_callback_takes_those_along_that_got_no_thread(make_pool, limit):
    pool = make_pool(None)
    first, second, ran = Strand(pool, "first"), Strand(pool, "second"), []
    limit.refuse("dyknow-worker")
    first.post(lambda: ran.append(1))
    limit.refuse("")
    second.post(lambda: ran.append(2))
    assert pool.drain(PATIENCE)
    assert ran == [1, 2]
    for number in range(3, 10):
        second.post(lambda number=number: ran.append(number))
        assert pool.drain(PATIENCE)
    assert ran == list(range(1, 10))


def test_blocked_callbacks_do_not_hold_up_one_that_got_no_thread(make_pool, limit):
    pool = make_pool(None)
    blockers = [Blocker(pool) for _ in range(3)]
    strand, ran = Strand(pool, "live"), threading.Event()
    limit.refuse("dyknow-worker")
    strand.post(ran.set)
    limit.refuse("")
    pool.catch_up()
    wait_for(ran)
    for blocker in blockers:
        blocker.release.set()


def test_the_watchdog_goes_on_when_it_gets_no_thread(make_pool, limit, caplog):
    clock = Clock()
    pool = make_pool(1, clock=clock)
    limit.refuse("dyknow-worker")
    blocker, waiting, ran = Blocker(pool), Strand(pool, "waiting"), threading.Event()
    waiting.post(ran.set)
    clock.seconds += 1.0
    clock.wait_read(5)
    eventually(lambda: "no thread can be started for callbacks" in caplog.text)
    assert (pool.threads, ran.is_set()) == (1, False)
    limit.refuse("")
    wait_for(ran)
    blocker.release.set()
    eventually(lambda: pool.threads == 1)
    run_on(waiting)
    assert caplog.text.count("no thread can be started for callbacks") == 1


def test_a_worker_for_which_there_is_no_other_goes_on(make_pool, limit, caplog):
    clock = Clock()
    pool = make_pool(1, clock=clock)
    limit.refuse("dyknow-worker")
    blocker, waiting = Blocker(pool), Strand(pool, "waiting")
    waiting.post(lambda: None)
    clock.seconds += 1.0
    eventually(lambda: "no thread can be started for callbacks" in caplog.text)
    blocker.release.set()
    run_on(waiting)
    assert pool.threads == 1


def test_a_pool_whose_threads_are_refused_is_not_made(limit):
    def workers():
        return {each for each in threading.enumerate() if each.name == "dyknow-worker"}

    before = workers()

    class Refusal(WorkerPool):
        def _hire(self):
            limit.refuse("dyknow-worker" if len(self._workers) == 2 else "")
            super()._hire()

    with pytest.raises(RuntimeError, match="can't start new thread"):
        Refusal(3)
    eventually(lambda: not workers() - before)
