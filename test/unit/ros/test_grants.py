# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a process is granted: leases, by the time for which the manager has run, and guards."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Dict

import pytest
from clocks import HandClock

from dyknow.errors import HostError, PeerTimeout
from dyknow.guards import Guards
from dyknow.manager.host import ProcessState
from dyknow.model.graph import NodeletKind
from dyknow.periodic import LONGEST_TICK, RunningClock
from dyknow.ros.hosting.grants import DURATION, GUARDS_PERIOD, Guarding, Lease, PeerContext
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


class Parameters(Master):
    """A master's parameter server, which answers unless it is away."""

    def __init__(self):
        super().__init__("/manager")
        self.values: Dict[str, Any] = {}
        self.is_away = False

    def ask(self, question, *args):
        if self.is_away:
            raise PeerTimeout("the ROS master", 1.0)
        if question == "setParam":
            self.values[args[0]] = args[1]
        elif question == "deleteParam":
            del self.values[args[0]]
        elif args[0] not in self.values:
            raise LookupError("not set")
        return self.values.get(args[0])


KEY = "/far/guards/manager"
STATE = ProcessState("/far", NodeletKind.PYTHON, "1")


class Guarded:
    """Guards of one process, the parameters at the master, and a clock."""

    def __init__(self):
        guards = Guards(denied_topics=("/e_stop",), allowed_topics=(("/a/*",),), read_only=True)
        self.clock = HandClock()
        self.master = Parameters()
        self.values = self.master.values
        self.context = PeerContext(self.master, guards, running=self.clock)
        self.guarding = Guarding(self.context, "/far")

    def hand_over(self, **change):
        self.guarding.hand_over(replace(STATE, **change))


@pytest.fixture
def guarded():
    return Guarded()


def test_guards_that_were_not_taken_are_handed_over_again(guarded, caplog):
    guarded.master.is_away = True
    for _ in range(2):
        guarded.hand_over()
        with pytest.raises(HostError, match="does not have the guards yet"):
            guarded.guarding.check()
    assert len(caplog.records) == 1
    guarded.master.is_away = False
    guarded.hand_over()
    guarded.guarding.check()
    assert guarded.values[KEY]["denied_topics"] == ["/e_stop"]
    assert guarded.values[KEY]["read_only"] is True


@pytest.mark.parametrize("change", [dict.clear, lambda found: found.update(denied_topics=[])])
def test_guards_that_are_missing_or_changed_are_handed_over_again(guarded, change):
    guarded.hand_over()
    given = dict(guarded.values[KEY])
    guarded.clock.time += GUARDS_PERIOD
    guarded.hand_over()
    assert guarded.values[KEY] == given
    change(guarded.values[KEY])
    guarded.hand_over()
    assert guarded.values[KEY] != given, "not each time: it costs an answer of the master"
    guarded.clock.time += GUARDS_PERIOD
    guarded.hand_over()
    assert guarded.values[KEY] == given


def test_other_processes_and_other_protected_nodelets_need_new_guards(guarded):
    for useless in ({"incarnation": ""}, {"rewirable": False}):  # dead, stock
        guarded.hand_over(**useless)
        assert guarded.values == {}
    guarded.hand_over()
    guarded.values.clear()
    guarded.hand_over(incarnation="2")
    assert guarded.values[KEY]["protected"] == []
    guarded.context.protected = {"/far": ["/b", "/a"], "/other": ["/c"]}
    guarded.hand_over(incarnation="2")
    assert guarded.values[KEY]["protected"] == ["/a", "/b"]
    guarded.guarding.withdraw()
    assert guarded.values == {}
