# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How long a manager takes a lease for granted, by the time for which it has run itself."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any, List

import pytest

from dyknow.errors import PeerTimeout
from dyknow.ros.hosting import lease_keeper
from dyknow.ros.hosting.lease_keeper import DURATION, LeaseKeeper
from dyknow.ros.service_client import ServiceLost
from dyknow.running_clock import LONGEST, RunningClock

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
    monkeypatch.setattr(lease_keeper, "ServiceClient", far)
    return far


class Time:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def keeper(clock: Time, ended: threading.Event | None = None) -> LeaseKeeper:
    ended = ended or threading.Event()
    return LeaseKeeper(None, "http://robot:1/", lambda name: True, clock, ended.set)  # type: ignore[arg-type]


def test_what_an_answer_said_is_confirmed_by_the_next_renewal(far: Far) -> None:
    kept = keeper(Time())
    kept.grant({"/topic": "/camera"}, ["/far"])
    first, second, third = far.wait_for(3)[:3]
    kept.close()
    assert [each["confirmed"] for each in (first, second, third)] == [0.0, 6.0, 7.0]
    assert first["topics"] == ["/topic"] and first["nodelets"] == ["/camera"]
    assert first["duration"] == DURATION


def test_a_process_that_is_lost_is_not_confirmed_what_another_one_said(far: Far) -> None:
    kept = keeper(Time())
    kept.grant({"/topic": "/camera"}, ["/far"])
    far.wait_for(2)
    far.error = ServiceLost("gone")
    count = len(far.wait_for(3))
    while far.wait_for(count)[-1]["confirmed"]:
        count += 1
    kept.close()


def test_a_lease_is_out_when_it_was_not_answered_for_its_duration(far: Far) -> None:
    clock, ended = Time(), threading.Event()
    kept = keeper(clock, ended)
    far.error = PeerTimeout("/far", 1.0)
    clock.now = 10.0
    kept.grant({"/topic": "/camera"}, ["/far"])
    far.wait_for(1)
    clock.now += DURATION - 0.1
    assert kept.may_publish("/far")
    clock.now += 0.2
    assert not kept.may_publish("/far")
    assert ended.wait(LONG)
    kept.close()


def test_what_an_earlier_life_granted_is_waited_for() -> None:
    clock = Time()
    kept = keeper(clock)
    assert kept.may_publish("/far")
    clock.now = DURATION
    assert not kept.may_publish("/far")


def test_a_pause_of_the_manager_does_not_count() -> None:
    steady = Time()
    running = RunningClock(steady)
    for _ in range(10):
        steady.now += 0.1
        running()
    steady.now += 10.0  # it was stopped
    assert running() == pytest.approx(1.0 + LONGEST)
