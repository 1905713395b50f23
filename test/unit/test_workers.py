# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The pool for work that may wait for others."""

from __future__ import annotations

import threading
from typing import List

import pytest

from dyknow.periodic import Workers

PATIENCE = 10.0


def test_one_worker_keeps_the_order() -> None:
    workers = Workers("testing", 1)
    done: List[int] = []
    over = threading.Event()
    for number in range(100):
        workers.run(lambda number=number: done.append(number))
    workers.run(over.set)
    assert over.wait(PATIENCE)
    workers.close(PATIENCE)
    assert done == list(range(100))


def test_as_much_is_done_at_the_same_time_as_there_are_threads() -> None:
    workers = Workers("testing", 3)
    together = threading.Barrier(4)
    for _ in range(3):
        workers.run(lambda: together.wait(PATIENCE))
    together.wait(PATIENCE)
    workers.close(PATIENCE)


def test_work_that_fails_is_logged_and_takes_no_thread_away(
    caplog: pytest.LogCaptureFixture,
) -> None:
    workers = Workers("testing", 1)
    over = threading.Event()
    workers.run(lambda: 1 // 0)
    workers.run(over.set)
    assert over.wait(PATIENCE)
    workers.close(PATIENCE)
    assert "testing failed" in caplog.text
    assert "ZeroDivisionError" in caplog.text


def test_close_begins_nothing_more_and_waits_for_what_was_begun() -> None:
    workers = Workers("testing", 1)
    begun, go_on = threading.Event(), threading.Event()
    done: List[str] = []

    def work() -> None:
        begun.set()
        assert go_on.wait(PATIENCE)
        done.append("begun")

    workers.run(work)
    workers.run(lambda: done.append("not begun"))
    assert begun.wait(PATIENCE)
    workers.close(0.01)
    assert done == []
    go_on.set()
    workers.close(PATIENCE)
    assert done == ["begun"]
