# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The periodic work of the manager's node: it works when there is reason to, or else sleeps."""

from __future__ import annotations

from typing import Any, Callable, Iterator

import pytest
from clocks import SteppedClock

from dyknow.errors import DyKnowError
from dyknow.manager.claim import Claim
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.periodic import PAUSE, RETRY
from dyknow.ros.manager.loops import PERIOD, ReconcileLoop, Watch


class FakeReconciler:
    """Counts rounds; the first one fails."""

    def __init__(self) -> None:
        self.living: list[Claim] = []
        self.rounds = 0

    def claims(self) -> list[Claim]:
        return self.living

    def reconcile(self) -> None:
        self.rounds += 1
        if self.rounds == 1:
            raise RuntimeError("the first round fails")


def claim(max_silence: float = 0.0, state: ClaimState = ClaimState.ACTIVE) -> Claim:
    return Claim("c", StreamRequest("Tag", max_silence=max_silence), state=state)


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


@pytest.fixture
def reconciler() -> FakeReconciler:
    return FakeReconciler()


@pytest.fixture
def reconciling(reconciler: Any, clock: SteppedClock) -> Iterator[ReconcileLoop]:
    made = ReconcileLoop(reconciler, lambda: bool(reconciler.living), clock)
    made.start()
    yield made
    made.close(5.0)
    assert not made._worker.running


def wake(loop: Any, clock: SteppedClock, wake: Callable[[], int]) -> None:
    """Wake a loop, and move on until its round is over."""
    number = wake()
    while not loop._worker.wait_for(number, 0.01):
        clock.advance(PAUSE)
    clock.settle()


def test_nothing_is_done_while_nothing_is_claimed(
    reconciler: FakeReconciler, reconciling: ReconcileLoop, clock: SteppedClock
) -> None:
    wake(reconciling, clock, reconciling.note_change)
    clock.advance(100.0)
    assert reconciler.rounds == 0
    assert reconciling.period() is None


def test_claims_are_looked_after_again_and_again_whatever_fails(
    reconciler: FakeReconciler, reconciling: ReconcileLoop, clock: SteppedClock
) -> None:
    reconciler.living = [claim()]
    wake(reconciling, clock, reconciling.note_change)
    assert reconciler.rounds == 1
    clock.advance(RETRY + PAUSE)
    clock.settle()
    assert reconciler.rounds == 2
    clock.advance(10 * PERIOD)
    assert reconciler.rounds >= 11


def test_when_the_last_claim_has_ended_the_keeper_lets_go(
    reconciler: FakeReconciler, reconciling: ReconcileLoop, clock: SteppedClock
) -> None:
    reconciler.living = [claim()]
    for _ in range(2):
        wake(reconciling, clock, reconciling.note_change)
    reconciler.living = []
    rounds = reconciler.rounds
    for _ in range(3):
        wake(reconciling, clock, reconciling.note_change)
    assert reconciler.rounds == rounds + 1


@pytest.mark.parametrize(
    ("claims", "period"),
    [
        ([claim()], PERIOD),
        ([claim(60.0)], PERIOD),
        ([claim(1.0), claim(0.4)], 0.1),
        ([claim(0.001)], PAUSE),
        ([claim(0.4, ClaimState.RELEASED), claim()], PERIOD),
    ],
)
def test_the_shortest_silence_sets_the_pace(
    reconciler: FakeReconciler, reconciling: ReconcileLoop, claims: list[Claim], period: float
) -> None:
    reconciler.living = claims
    assert reconciling.period() == pytest.approx(period)


class FakeManager:
    """Records its looks; the first one that names a nodelet fails."""

    def __init__(self) -> None:
        self.graph = self
        self.busy: set[str] = set()
        self.looks: list[set[str]] = []
        self.after = 0

    def is_busy(self, name: str) -> bool:
        return name in self.busy

    def look(self, changed: set[str]) -> None:
        self.looks.append(set(changed))
        if changed and sum(map(bool, self.looks)) == 1:
            raise DyKnowError("the first look fails")

    def note_after(self) -> None:
        self.after += 1


@pytest.fixture
def manager() -> FakeManager:
    return FakeManager()


@pytest.fixture
def watch(manager: Any, clock: SteppedClock) -> Iterator[Watch]:
    made = Watch(manager, manager.note_after, clock)
    made.start()
    yield made
    made.close(5.0)
    assert not made._worker.running


def test_a_change_is_looked_at_closely_once(
    manager: FakeManager, watch: Watch, clock: SteppedClock
) -> None:
    for name in ("/a", "/b"):
        watch.refresh(name)
        wake(watch, clock, watch.refresh_now)
    clock.advance(10 * PERIOD)
    assert [each for each in manager.looks if each] == [{"/a"}, {"/b"}]
    assert len(manager.looks) >= 11
    assert manager.after == len(manager.looks), "also after a look that failed"


def test_a_busy_nodelet_is_looked_at_again(
    manager: FakeManager, watch: Watch, clock: SteppedClock
) -> None:
    manager.busy.add("/a")
    watch.refresh("/a")
    for _ in range(3):
        wake(watch, clock, watch.refresh_now)
    assert manager.looks[-3:] == [{"/a"}] * 3
    manager.busy.clear()
    for _ in range(2):
        wake(watch, clock, watch.refresh_now)
    assert manager.looks[-1] == set(), "it is free, and looked at no more"
