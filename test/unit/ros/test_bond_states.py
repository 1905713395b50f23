# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""One end of a bond, with a clock set by the test."""

from __future__ import annotations

import pytest

from dyknow.ros.bonding.bond_states import NOTHING, BondEnd, BondState, BondTimings, Outcome

TIMINGS = BondTimings(
    connect_timeout=10.0,
    heartbeat_timeout=4.0,
    disconnect_timeout=2.0,
    heartbeat_period=1.0,
    dead_publish_period=0.5,
)


@pytest.fixture
def end():
    return BondEnd("id", "we", TIMINGS, now=0.0)


def formed():
    end = BondEnd("id", "we", TIMINGS, now=0.0)
    end.hear("she", True, 1.0)
    return end


def test_the_first_word_forms_the_bond_and_is_answered_at_once(end):
    assert end.hear("she", True, 3.0) == Outcome(say=True)
    assert end.state is BondState.ALIVE
    assert end.deadline == 7.0


def test_heartbeats_keep_the_bond(end):
    for now in range(1, 20):
        end.hear("she", True, float(now))
        assert end.tick(now + 3.9) == NOTHING
    assert end.state is BondState.ALIVE


def test_a_sister_who_never_comes_breaks_the_bond(end):
    assert end.tick(9.9) == NOTHING
    assert end.tick(10.0) == Outcome(say=False, broken=True)
    assert end.forgettable
    assert end.tick(99.0) == NOTHING


def test_silence_counts_from_the_first_word():
    end = formed()
    assert end.tick(4.9) == NOTHING
    assert end.tick(5.0) == Outcome(silent=True)
    assert end.tick(5.1) == NOTHING
    assert end.judge_silence(True, 5.2) == Outcome(say=False, broken=True)
    assert end.forgettable


def test_silence_that_does_not_count_is_measured_again():
    end = formed()
    end.tick(5.0)
    assert end.judge_silence(False, 5.5) == NOTHING
    assert end.deadline == 9.5
    assert end.tick(9.5) == Outcome(silent=True)


def test_a_word_between_silence_and_verdict_saves_the_bond():
    end = formed()
    end.tick(5.0)
    end.hear("she", True, 5.1)
    assert end.judge_silence(True, 5.2) == NOTHING
    assert end.state is BondState.ALIVE


def test_parting_between_silence_and_verdict_stays_on_purpose():
    end = formed()
    end.tick(5.0)
    end.part(5.1)
    assert end.judge_silence(True, 5.2) == NOTHING
    assert end.state is BondState.PARTING


@pytest.mark.parametrize("heard_before", [True, False])
def test_the_sisters_death_is_acknowledged_each_time_and_told_once(end, heard_before):
    if heard_before:
        end.hear("she", True, 1.0)
    assert end.hear("she", False, 2.0) == Outcome(say=False, broken=True)
    assert end.hear("she", False, 2.1) == Outcome(say=False)
    assert not end.forgettable
    assert end.tick(4.0) == NOTHING
    assert end.forgettable
    assert end.hear("she", False, 4.1) == NOTHING


def test_a_dead_sister_does_not_come_back(end):
    end.hear("she", False, 2.0)
    assert end.hear("she", True, 2.1) == NOTHING
    assert end.state is BondState.DEAD


@pytest.mark.parametrize("heard_before", [True, False])
def test_parting_is_repeated_until_the_sister_acknowledges(end, heard_before):
    if heard_before:
        end.hear("she", True, 1.0)
    assert end.part(2.0) == Outcome(say=False)
    assert end.tick(2.4) == NOTHING
    assert end.tick(2.5) == Outcome(say=False)
    assert end.hear("she", True, 2.6) == NOTHING
    assert end.hear("she", False, 2.7) == NOTHING
    assert end.forgettable


def test_parting_without_acknowledgement_ends_too():
    end = formed()
    end.part(2.0)
    said = 0
    while not end.forgettable:
        assert end.deadline is not None
        said += end.tick(end.deadline) == Outcome(say=False)
    assert said == 3


def test_parting_twice_or_after_death_says_nothing():
    end = formed()
    end.part(2.0)
    assert end.part(2.1) == NOTHING
    end.hear("she", False, 2.2)
    assert end.part(2.3) == NOTHING


def test_our_own_words_are_ignored(end):
    assert end.hear("we", False, 1.0) == NOTHING
    assert end.state is BondState.WAITING


def test_a_third_party_is_reported_and_ignored():
    end = formed()
    assert end.hear("intruder", False, 2.0) == Outcome(intruder=True)
    assert end.state is BondState.ALIVE
    assert end.deadline == 5.0


def test_last_words_to_an_earlier_bond_do_not_count():
    former = formed()
    former.part(2.0)
    end = BondEnd("id", "we too", TIMINGS, now=2.0, former=former)
    assert end.hear("she", True, 2.1) == NOTHING
    assert end.hear("she", False, 2.1) == NOTHING
    assert end.hear("we", False, 2.1) == NOTHING
    assert end.hear("she again", True, 2.2) == Outcome(say=True)
    assert end.hear("she", False, 9.0) == NOTHING
    assert end.hear("we", True, 9.0) == NOTHING


def test_a_sister_of_an_earlier_bond_who_lives_on_is_taken_up_again():
    former = formed()
    former.part(2.0)
    end = BondEnd("id", "we too", TIMINGS, now=2.5, former=former)
    assert end.hear("she", True, 4.4) == NOTHING
    assert end.hear("she", False, 4.5) == NOTHING
    assert end.hear("we", True, 4.5) == NOTHING
    assert end.hear("she", True, 4.5) == Outcome(say=True)
    assert end.state is BondState.ALIVE
    assert end.hear("she", False, 5.0) == Outcome(say=False, broken=True)
