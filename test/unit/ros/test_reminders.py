# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which subscribers are notified again of a topic that is back, and for how long."""

from __future__ import annotations

from typing import List, Optional

import pytest

from dyknow.ros.transport.reminders import LATELY, Addresses, Reminders

FAST, SLOW = frozenset({"http://fast:1"}), frozenset({"http://slow:1"})
BOTH = FAST | SLOW


class Surroundings:
    """The master and the subscribers, and time that is moved by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        self.subscribed: Optional[Addresses] = BOTH
        self.connected = FAST
        self.told: List[str] = []
        self.reminders = Reminders(self.tell_again, lambda topic: self.connected, lambda: self.now)
        monkeypatch.setattr(
            self.reminders._worker, "start", lambda: None
        )  # the test makes the looks

    def tell_again(self, topic: str, datatype: str) -> Optional[Addresses]:
        self.told.append(f"{topic} {datatype}")
        return self.subscribed

    def come_back(self, away: float = 0.1) -> None:
        self.reminders.withdrawn("/t")
        self.now += away
        self.reminders.advertised("/t", "pkg/T", BOTH)

    def wait(self, seconds: float) -> int:
        """Let time pass; returns how often all were notified again."""
        before = len(self.told)
        for _ in range(round(seconds * 10)):
            self.now += 0.1
            self.reminders.look()
        return len(self.told) - before


@pytest.fixture
def around(monkeypatch: pytest.MonkeyPatch) -> Surroundings:
    return Surroundings(monkeypatch)


def test_who_is_missing_is_told_until_it_has_come(around: Surroundings) -> None:
    around.come_back()
    assert around.wait(10.0) > 2
    assert set(around.told) == {"/t pkg/T"}
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
