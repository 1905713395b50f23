# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Pauses grow while failures repeat, and for no other reason."""

from __future__ import annotations

from typing import List

import pytest

from dyknow.backoff import FORGIVEN_AFTER, LONGEST, MEMORY, SHARE, Backoff

FIRST = 0.25


class Life:
    """Fails and is tried again, on a clock set by hand."""

    def __init__(self, tolerated: int = 1) -> None:
        self.now = 100.0
        self.backoff = Backoff(lambda: self.now, FIRST, tolerated=tolerated)

    def fail(self, served: float = 0.0) -> float:
        """Fail after some seconds of service; wait for the pause, and return its length."""
        self.now += served
        self.backoff.served("/a", served)
        self.backoff.failed("/a")
        begin = self.now
        while not self.backoff.allows("/a"):
            assert self.backoff.paused == {"/a"}
            self.now += 0.125
        assert self.backoff.paused == frozenset()
        return self.now - begin

    def pauses(self, count: int, served: float = 0.0) -> List[float]:
        return [self.fail(served) for _ in range(count)]


@pytest.mark.parametrize(
    ("tolerated", "served", "pauses"),
    [
        (1, 0.0, [0.0, 0.25, 0.5, 1.0, 2.0, 4.0]),
        (0, 0.0, [0.25, 0.5, 1.0]),
        # A long service is no reason to wait, however often it ends.
        (1, FORGIVEN_AFTER, [0.0] * 50),
    ],
)
def test_pauses_double_after_the_tolerated_failures(
    tolerated: int, served: float, pauses: List[float]
) -> None:
    assert Life(tolerated).pauses(len(pauses), served) == pauses


@pytest.mark.parametrize("served", [0.0, FORGIVEN_AFTER / 2])
def test_pauses_have_a_longest_one_and_are_no_service(served: float) -> None:
    assert Life().pauses(14, served)[-3:] == [LONGEST] * 3


def test_a_failure_that_was_forgiven_is_the_first_again() -> None:
    life = Life()
    life.pauses(5)
    life.backoff.forgive("/a")
    assert life.pauses(2) == [0.0, 0.25]


def test_failures_of_long_ago_are_not_remembered() -> None:
    life = Life()
    for number in range(100):
        life.backoff.failed(f"/{number}")
        life.now += MEMORY / 10
    assert len(life.backoff._failures) < 15


def test_a_pause_is_a_small_part_of_the_service_that_it_follows() -> None:
    life = Life()
    for _ in range(12):
        life.now += 5.0
        life.backoff.failed("/a", after=5.0)
    assert life.backoff.remaining("/a") == SHARE * 5.0
    life.backoff.failed("/a", after=FIRST)
    assert life.backoff.remaining("/a") == LONGEST


def test_what_comes_of_one_cause_is_one_failure() -> None:
    life = Life()
    for cause in ("first", "first", "first"):
        life.backoff.failed("/a", cause=cause)
    assert life.backoff.remaining("/a") == 0.0
    life.backoff.failed("/a", cause="second")
    assert life.backoff.remaining("/a") == FIRST
