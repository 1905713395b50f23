# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a process is granted: leases, by the time for which the manager has run, and guards."""

from __future__ import annotations

import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, Callable, Dict, List, cast

import pytest
from clocks import HandClock

from dyknow.errors import HostError, PeerTimeout
from dyknow.guards import Guards
from dyknow.manager.host import ProcessState
from dyknow.model.graph import NodeletKind
from dyknow.periodic import LONGEST_TICK, RunningClock
from dyknow.ros.hosting import grants
from dyknow.ros.hosting.grants import DURATION, GUARDS_PERIOD, Guarding, Lease, PeerContext
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceLost

LONG = 30.0


class Far:
    """A nodelet manager, as the keeper's clients see it."""

    def __init__(self) -> None:
        self.requests: List[Any] = []
        self.error: Exception | None = None
        self.clock = 5.0
        self.asked = threading.Condition()

    def __call__(self, *unused: Any, **kwds: Any) -> Far:
        return self

    def call(self, timeout: float, **request: Any) -> Any:
        with self.asked:
            self.requests.append(request)
            self.asked.notify_all()
        if self.error is not None:
            raise self.error
        self.clock += 1.0
        return SimpleNamespace(clock=self.clock)

    def close(self) -> None:
        pass

    def wait_for(self, count: int) -> List[Any]:
        with self.asked:
            assert self.asked.wait_for(lambda: len(self.requests) >= count, LONG)
            return list(self.requests)


@pytest.fixture
def far(monkeypatch: pytest.MonkeyPatch) -> Far:
    far = Far()
    monkeypatch.setattr(grants, "ServiceClient", far)
    return far


def lease(clock: HandClock, ended: threading.Event | None = None) -> Lease:
    ended = ended or threading.Event()
    context = PeerContext(
        Master("/manager"), on_change=ended.set, running=clock, producers={"/topic": "/camera"}
    )
    return Lease(context, "/far", lambda: True)


def test_what_an_answer_said_is_confirmed_by_the_next_renewal(far: Far) -> None:
    kept = lease(HandClock())
    kept.grant()
    first, second, third = far.wait_for(3)[:3]
    kept.close()
    assert [each["confirmed"] for each in (first, second, third)] == [0.0, 6.0, 7.0]
    assert first["topics"] == ["/topic"] and first["nodelets"] == ["/camera"]
    assert first["duration"] == DURATION


def test_a_process_that_is_lost_is_not_confirmed_what_another_one_said(far: Far) -> None:
    kept = lease(HandClock())
    kept.grant()
    far.wait_for(2)
    far.error = ServiceLost("gone")
    count = len(far.wait_for(3))
    while far.wait_for(count)[-1]["confirmed"]:
        count += 1
    kept.close()


def test_a_lease_is_out_when_it_was_not_answered_for_its_duration(far: Far) -> None:
    clock, ended = HandClock(), threading.Event()
    kept = lease(clock, ended)
    far.error = PeerTimeout("/far", 1.0)
    clock.time = 10.0
    kept.grant()
    far.wait_for(1)
    clock.time += DURATION - 0.1
    assert kept.may_be_held
    clock.time += 0.2
    assert not kept.may_be_held
    assert ended.wait(LONG)
    kept.close()


def test_what_an_earlier_life_granted_is_waited_for() -> None:
    clock = HandClock()
    kept = lease(clock)
    assert kept.may_be_held
    clock.time = DURATION
    assert not kept.may_be_held


def test_a_pause_of_the_manager_does_not_count() -> None:
    steady = HandClock()
    running = RunningClock(steady)
    for _ in range(10):
        steady.time += 0.1
        running()
    steady.time += 10.0  # it was stopped
    assert running() == pytest.approx(1.0 + LONGEST_TICK)


class Parameters(Master):
    """A master's parameter server, which answers unless it is away."""

    def __init__(self) -> None:
        super().__init__("/manager")
        self.values: Dict[str, Any] = {}
        self.is_away = False

    def ask(self, question: str, *args: Any) -> Any:
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


@pytest.fixture
def guarding() -> Guarding:
    guards = Guards(denied_topics=("/e_stop",), allowed_topics=(("/a/*",),), read_only=True)
    return Guarding(PeerContext(Parameters(), guards, clock=HandClock()), "/far")


def values(guarding: Guarding) -> Dict[str, Any]:
    return cast(Parameters, guarding._context.master).values


def test_guards_that_were_not_taken_are_handed_over_again(
    guarding: Guarding, caplog: pytest.LogCaptureFixture
) -> None:
    """Until the master has confirmed them nothing may be loaded."""
    master = cast(Parameters, guarding._context.master)
    master.is_away = True
    for _ in range(2):
        guarding.hand_over(STATE)
        with pytest.raises(HostError, match="does not have the guards yet"):
            guarding.check()
    assert len(caplog.records) == 1
    master.is_away = False
    guarding.hand_over(STATE)
    guarding.check()
    assert master.values[KEY]["denied_topics"] == ["/e_stop"]
    assert master.values[KEY]["read_only"] is True


@pytest.mark.parametrize("change", [dict.clear, lambda found: found.update(denied_topics=[])])
def test_guards_that_are_missing_or_changed_are_handed_over_again(
    guarding: Guarding, change: Callable[[Dict[str, Any]], None]
) -> None:
    clock = cast(HandClock, guarding._context.clock)
    guarding.hand_over(STATE)
    given = dict(values(guarding)[KEY])
    clock.time += GUARDS_PERIOD
    guarding.hand_over(STATE)
    assert values(guarding)[KEY] == given
    change(values(guarding)[KEY])
    guarding.hand_over(STATE)
    assert values(guarding)[KEY] != given, "not each time: it costs an answer of the master"
    clock.time += GUARDS_PERIOD
    guarding.hand_over(STATE)
    assert values(guarding)[KEY] == given


def test_another_process_and_other_protected_nodelets_need_new_guards(guarding: Guarding) -> None:
    guarding.hand_over(STATE)
    values(guarding).clear()
    guarding.hand_over(replace(STATE, incarnation="2"))
    assert values(guarding)[KEY]["protected"] == []
    guarding._context.protected = {"/far": ["/b", "/a"], "/other": ["/c"]}
    guarding.hand_over(replace(STATE, incarnation="2"))
    assert values(guarding)[KEY]["protected"] == ["/a", "/b"]
    guarding.withdraw()
    assert values(guarding) == {}


@pytest.mark.parametrize("change", [{"incarnation": ""}, {"rewirable": False}])
def test_dead_and_stock_nodelet_managers_get_no_guards(
    guarding: Guarding, change: Dict[str, Any]
) -> None:
    guarding.hand_over(replace(STATE, **change))
    assert values(guarding) == {}
