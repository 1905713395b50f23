# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Subscribers that connect late: the messages kept for them, and the reminders."""

from __future__ import annotations

from typing import List, Optional

import pytest

from dyknow.ros.transport.late_subscribers import LATELY, LONGEST, Addresses, Backlog, Reminders

ONE, TWO, THREE = "http://one", "http://two", "http://three"


def test_each_late_subscriber_receives_once_the_messages_that_it_missed() -> None:
    backlog = Backlog()
    backlog.keep("early")
    assert not backlog.waiting()
    assert backlog.missed_by(ONE) == []
    backlog.expect([ONE, TWO], 10)
    backlog.keep(1)
    assert backlog.missed_by(THREE) == []
    assert backlog.missed_by("") == []
    assert backlog.missed_by(ONE) == [1]
    assert backlog.missed_by(ONE) == []
    backlog.keep(2)
    assert backlog.waiting()
    assert backlog.missed_by(TWO) == [1, 2]
    assert not backlog.waiting()
    assert backlog.missed_by(THREE) == []


def test_nothing_is_kept_where_no_subscriber_is_due() -> None:
    backlog = Backlog()
    backlog.expect([], 10)
    assert not backlog.waiting()
    backlog.keep(1)
    assert backlog.missed_by(ONE) == []


@pytest.mark.parametrize(("size", "kept"), [(2, 2), (0, 1000)])
def test_the_oldest_messages_are_dropped(size: int, kept: int) -> None:
    backlog = Backlog()
    backlog.expect([ONE], size)
    for number in range(5000):
        backlog.keep(number)
    assert backlog.missed_by(ONE) == list(range(5000 - kept, 5000))


def test_a_dead_subscriber_is_given_up() -> None:
    now = [100.0]
    backlog = Backlog(lambda: now[0])
    backlog.expect([ONE], 10)
    backlog.keep(1)
    now[0] += LONGEST
    assert not backlog.waiting()
    assert backlog.missed_by(ONE) == []


FAST, SLOW = frozenset({"http://fast:1"}), frozenset({"http://slow:1"})
BOTH = FAST | SLOW


class Surroundings:
    """The master and the subscribers, and time that is moved by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        self.subscribed: Optional[Addresses] = BOTH
        self.connected = FAST
        self.notified: List[str] = []
        self.reminders = Reminders(
            self.register_again, lambda topic: self.connected, lambda: self.now
        )
        monkeypatch.setattr(
            self.reminders._worker, "start", lambda: None
        )  # the test makes the looks

    def register_again(self, topic: str, datatype: str) -> Optional[Addresses]:
        self.notified.append(f"{topic} {datatype}")
        return self.subscribed

    def come_back(self, away: float = 0.1) -> None:
        self.reminders.withdrawn("/t")
        self.now += away
        self.reminders.advertised("/t", "pkg/T", BOTH)

    def wait(self, seconds: float) -> int:
        """Let time pass; returns how often all were notified again."""
        before = len(self.notified)
        for _ in range(round(seconds * 10)):
            self.now += 0.1
            self.reminders.remind()
        return len(self.notified) - before


@pytest.fixture
def around(monkeypatch: pytest.MonkeyPatch) -> Surroundings:
    return Surroundings(monkeypatch)


def test_who_is_missing_is_told_until_it_has_come(around: Surroundings) -> None:
    around.come_back()
    assert around.wait(10.0) > 2
    assert set(around.notified) == {"/t pkg/T"}
    around.connected = BOTH
    assert around.wait(100.0) == 0


def test_who_never_comes_is_not_told_for_ever(around: Surroundings) -> None:
    around.come_back()
    assert 4 <= around.wait(200.0) <= 8
    assert around.wait(200.0) == 0


def test_nobody_is_told_again_when_all_have_come_at_once(around: Surroundings) -> None:
    around.connected = BOTH
    around.come_back()
    assert around.wait(100.0) == 0


def test_a_topic_that_is_new_or_was_long_gone_needs_no_reminder(around: Surroundings) -> None:
    around.reminders.advertised("/t", "pkg/T", BOTH)
    assert around.wait(10.0) == 0
    around.come_back(LATELY + 1.0)
    assert around.wait(10.0) == 0


def test_who_subscribes_no_more_is_not_missing(around: Surroundings) -> None:
    around.subscribed = FAST
    around.come_back()
    assert around.wait(100.0) == 1


def test_a_master_that_is_away_is_asked_again(around: Surroundings) -> None:
    around.subscribed = None
    around.come_back()
    assert around.wait(10.0) > 2
    around.subscribed = BOTH
    assert around.wait(10.0) > 0


def test_a_topic_that_is_gone_again_is_left_alone(around: Surroundings) -> None:
    around.come_back()
    around.reminders.withdrawn("/t")
    assert around.wait(10.0) == 0
