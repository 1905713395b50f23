# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Leases, by the time for which the manager has run."""

from __future__ import annotations

import pytest
from clocks import HandClock

from dyknow.periodic import LONGEST_TICK, RunningClock
from dyknow.ros.hosting.grants import DURATION, Lease, PeerContext
from dyknow.ros.wire.master import Master


def lease(clock):
    context = PeerContext(Master("/manager"), running=clock, producers={"/topic": "/camera"})
    return Lease(context)


def test_a_renewal_confirms_the_last_answer_of_the_same_process():
    kept = lease(HandClock())
    assert kept.renewal() == {}
    kept.answered(5.0)
    assert kept.renewal() == {}
    kept.grant()
    renewal = kept.renewal()
    assert (renewal["topics"], renewal["nodelets"]) == (["/topic"], ["/camera"])
    assert (renewal["confirmed"], renewal["duration"]) == (5.0, DURATION)
    kept.answered(6.0)
    assert kept.renewal()["confirmed"] == 6.0
    released = kept.release()
    assert (released["topics"], released["duration"]) == ([], DURATION)
    kept.forget_clock()
    assert kept.renewal()["confirmed"] == 0.0


def test_a_lease_is_out_when_it_was_not_answered_for_its_duration():
    """One may be held that an earlier life of the manager granted."""
    clock = HandClock()
    kept = lease(clock)
    assert kept.may_be_held
    clock.time = DURATION
    assert not kept.may_be_held and kept.has_just_run_out()
    kept.grant()
    clock.time += DURATION - 0.1
    assert kept.may_be_held and not kept.has_just_run_out()
    clock.time += 0.2
    assert not kept.may_be_held
    assert [kept.has_just_run_out() for _ in range(2)] == [True, False]


def test_a_pause_of_the_manager_does_not_count():
    steady = HandClock()
    running = RunningClock(steady)
    for _ in range(10):
        steady.time += 0.1
        running()
    steady.time += 10.0  # it was stopped
    assert running() == pytest.approx(1.0 + LONGEST_TICK)
