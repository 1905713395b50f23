# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Subscribers that connect late: the messages kept for them, and the reminders."""

from __future__ import annotations

import pytest

from dyknow.ros.transport.late_subscribers import LATELY, LONGEST, Backlog, Reminders

ONE, TWO, THREE = "http://one", "http://two", "http://three"


def test_each_late_subscriber_receives_once_the_messages_that_it_missed():
    backlog = Backlog()
    backlog.keep("early")
    backlog.expect([], 10)
    backlog.keep("nobody is due")
    assert not backlog.waiting() and backlog.missed_by(ONE) == []
    backlog.expect([ONE, TWO], 10)
    backlog.keep(1)
    assert [backlog.missed_by(each) for each in (THREE, "", ONE, ONE)] == [[], [], [1], []]
    backlog.keep(2)
    assert backlog.waiting()
    assert backlog.missed_by(TWO) == [1, 2]
    assert not backlog.waiting() and backlog.missed_by(THREE) == []


@pytest.mark.parametrize(("size", "kept"), [(2, 2), (0, 1000)])
def test_the_oldest_messages_are_dropped(size, kept):
    backlog = Backlog()
    backlog.expect([ONE], size)
    for number in range(5000):
        backlog.keep(number)
    assert backlog.missed_by(ONE) == list(range(5000 - kept, 5000))


def test_a_dead_subscriber_is_given_up():
    now = [100.0]
    backlog = Backlog(lambda: now[0])
    backlog.expect([ONE], 10)
    backlog.keep(1)
    now[0] += LONGEST
    assert not backlog.waiting() and backlog.missed_by(ONE) == []


class Surroundings:
    """The master and two subscribers, and time that is moved by hand."""

    def __init__(self, monkeypatch):
        self.now = 0.0
        self.subscribed = frozenset((ONE, TWO))
        self.connected = frozenset((ONE,))
        self.notified = []
        self.reminders = Reminders(self.register_again, lambda _: self.connected, lambda: self.now)
        monkeypatch.setattr(
            self.reminders._worker, "start", lambda: None
        )  # the test has its rounds

    def register_again(self, topic, datatype):
        self.notified.append((topic, datatype))
        return self.subscribed

    def come_back(self, away=0.1):
        self.reminders.withdrawn("/t")
        self.now += away
        self.advertise()

    def advertise(self):
        self.reminders.advertised("/t", "pkg/T", frozenset((ONE, TWO)))

    def wait(self, seconds):
        """Let time pass; returns how often all subscribers were notified again."""
        before = len(self.notified)
        for _ in range(round(seconds * 10)):
            self.now += 0.1
            self.reminders.remind()
        return len(self.notified) - before


@pytest.fixture(name="around")
def _around(monkeypatch):
    return Surroundings(monkeypatch)


def test_a_missing_subscriber_is_reminded_until_it_connects(around):
    around.come_back()
    assert around.wait(10.0) > 2
    assert set(around.notified) == {("/t", "pkg/T")}
    around.connected = around.subscribed
    assert around.wait(100.0) == 0


def test_a_subscriber_that_never_connects_is_given_up(around):
    around.come_back()
    assert 4 <= around.wait(200.0) <= 8
    assert around.wait(200.0) == 0


@pytest.mark.parametrize(
    ("connected", "subscribed", "away", "reminders"),
    [
        ([ONE, TWO], [ONE, TWO], 0.1, 0),
        ([ONE], [ONE], 0.1, 1),  # the other one has unsubscribed, as this shows
        ([ONE], [ONE, TWO], LATELY + 1.0, 0),
    ],
)
def test_no_subscriber_that_is_there_or_gone_is_reminded(
    around, connected, subscribed, away, reminders
):
    around.connected, around.subscribed = frozenset(connected), frozenset(subscribed)
    around.come_back(away)
    assert around.wait(100.0) == reminders


def test_a_topic_that_is_new_or_withdrawn_again_needs_no_reminder(around):
    around.advertise()
    assert around.wait(10.0) == 0
    around.come_back()
    around.reminders.withdrawn("/t")
    assert around.wait(10.0) == 0


def test_a_master_that_is_away_is_asked_again(around):
    around.subscribed = None
    around.come_back()
    assert around.wait(10.0) > 2
    around.subscribed = frozenset((ONE, TWO))
    assert around.wait(10.0) > 0
