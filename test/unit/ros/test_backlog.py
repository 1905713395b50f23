# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Messages that are kept for subscribers that connect late."""

from __future__ import annotations

import pytest

from dyknow.ros.transport.backlog import LONGEST, Backlog


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def backlog(clock):
    return Backlog(clock)


def test_nobody_is_expected_at_first(backlog):
    backlog.keep("early")
    assert not backlog.waiting()
    assert backlog.greet("anyone") == []


def test_each_that_is_late_gets_what_it_missed(backlog):
    backlog.expect(["http://one", "http://two"], 10)
    backlog.keep(1)
    assert backlog.greet("http://one") == [1]
    backlog.keep(2)
    assert backlog.waiting()
    assert backlog.greet("http://two") == [1, 2]
    assert not backlog.waiting()
    assert backlog.greet("http://three") == []


def test_who_connects_twice_gets_nothing_twice(backlog):
    backlog.expect(["http://one", "http://two"], 10)
    backlog.keep(1)
    assert backlog.greet("http://one") == [1]
    assert backlog.greet("http://one") == []
    assert backlog.waiting()


def test_who_was_not_told_gets_nothing(backlog):
    backlog.expect(["http://one"], 10)
    backlog.keep(1)
    assert backlog.greet("http://two") == []
    assert backlog.greet("") == []
    assert backlog.waiting()
    assert backlog.greet("http://one") == [1]


def test_where_nobody_is_due_nothing_is_kept(backlog):
    backlog.expect([], 10)
    assert not backlog.waiting()
    backlog.keep(1)
    assert backlog.greet("http://one") == []


def test_the_oldest_go_first(backlog):
    backlog.expect(["http://one"], 2)
    for number in range(5):
        backlog.keep(number)
    assert backlog.greet("http://one") == [3, 4]


def test_a_queue_without_bounds_is_bounded_here(backlog):
    backlog.expect(["http://one"], 0)
    for number in range(5000):
        backlog.keep(number)
    missed = backlog.greet("http://one")
    assert len(missed) == 1000
    assert missed[-1] == 4999


def test_who_does_not_come_is_not_waited_for_for_ever(backlog, clock):
    backlog.expect(["http://dead"], 10)
    backlog.keep(1)
    clock.now += LONGEST
    assert not backlog.waiting()
    assert backlog.greet("http://dead") == []
