# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A thread for every callback that blocks."""

from __future__ import annotations

import functools
import threading
from typing import Iterator, List

import pytest

from dyknow.nodelet.scheduler import Strand, WorkerPool

PATIENCE = 10.0


@pytest.fixture
def pool() -> Iterator[WorkerPool]:
    pool = WorkerPool(None, stay=0.2)
    yield pool
    pool.close()


def threads() -> List[threading.Thread]:
    return [each for each in threading.enumerate() if each.name == "dyknow-worker"]


def test_blocked_callbacks_hold_up_nobody(pool: WorkerPool) -> None:
    gate, inside = threading.Event(), threading.Semaphore(0)

    def block() -> None:
        inside.release()
        gate.wait(PATIENCE)

    for number in range(20):
        Strand(pool, f"s{number}").post(block)
    assert all(inside.acquire(timeout=PATIENCE) for _ in range(20))
    gate.set()
    assert pool.drain(PATIENCE)


def test_a_strand_keeps_its_order_and_never_overlaps(pool: WorkerPool) -> None:
    strand = Strand(pool, "s")
    seen: List[int] = []
    running: List[int] = []
    most: List[int] = []

    def task(number: int) -> None:
        running.append(number)
        most.append(len(running))
        seen.append(number)
        running.pop()

    def post(first: int) -> None:
        for number in range(first, first + 500):
            strand.post(functools.partial(task, number))

    posting = [threading.Thread(target=post, args=(first,)) for first in (0, 500)]
    for thread in posting:
        thread.start()
    for thread in posting:
        thread.join()
    assert pool.drain(PATIENCE)
    assert sorted(seen) == list(range(1000)) and set(most) == {1}
    assert [n for n in seen if n < 500] == list(range(500))


def test_threads_are_used_again_and_leave_when_nothing_is_to_do(pool: WorkerPool) -> None:
    strand = Strand(pool, "s")
    names = set()
    for _ in range(10):
        strand.post(lambda: names.add(threading.get_ident()))
        assert pool.drain(PATIENCE)
    assert len(names) <= 3
    deadline = threading.Event()
    for _ in range(200):
        if not threads():
            break
        deadline.wait(0.05)
    assert threads() == []
    strand.post(lambda: names.add(0))
    assert pool.drain(PATIENCE) and 0 in names


def test_killed_strands_run_nothing_more(pool: WorkerPool) -> None:
    strand = Strand(pool, "s", held=True)
    seen: List[int] = []
    strand.post(lambda: seen.append(1))
    strand.kill()
    strand.resume()
    assert pool.drain(PATIENCE)
    assert seen == []


def test_a_closed_pool_runs_nothing(pool: WorkerPool) -> None:
    pool.close()
    seen: List[int] = []
    strand = Strand(pool, "s")
    strand.post(lambda: seen.append(1))
    assert not pool.drain(0.05) and seen == []
