# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The thread that looks after streams: it works when there is reason to, or else sleeps."""

from __future__ import annotations

import threading
from typing import Any, Iterator

import pytest

from dyknow.manager.claim import Claim
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.periodic import PAUSE
from dyknow.ros.manager.loops import PERIOD, ReconcileLoop


class FakeReconciler:
    """Counts rounds; the first one fails."""

    def __init__(self) -> None:
        self.living: list[Claim] = []
        self.rounds = 0
        self.done = threading.Condition()

    def claims(self) -> list[Claim]:
        return self.living

    def reconcile(self) -> None:
        with self.done:
            self.rounds += 1
            self.done.notify_all()
        if self.rounds == 1:
            raise RuntimeError("the first round fails")

    def await_rounds(self, count: int, timeout: float = 10.0) -> bool:
        with self.done:
            return self.done.wait_for(lambda: self.rounds >= count, timeout)


def claim(max_silence: float = 0.0, state: ClaimState = ClaimState.ACTIVE) -> Claim:
    return Claim("c", StreamRequest("Tag", max_silence=max_silence), state=state)


@pytest.fixture
def reconciler() -> FakeReconciler:
    return FakeReconciler()


@pytest.fixture
def reconciling(reconciler: Any) -> Iterator[ReconcileLoop]:
    made = ReconcileLoop(reconciler, lambda: bool(reconciler.living))
    made.start()
    yield made
    made.close(5.0)
    assert not made._worker.running


def test_nothing_is_done_while_nothing_is_claimed(
    reconciler: FakeReconciler, reconciling: ReconcileLoop
) -> None:
    reconciling.note_change()
    assert not reconciler.await_rounds(1, 0.3)
    assert reconciling.period() is None


def test_claims_are_looked_after_again_and_again_whatever_fails(
    reconciler: FakeReconciler, reconciling: ReconcileLoop
) -> None:
    reconciler.living = [claim()]
    reconciling.note_change()
    assert reconciler.await_rounds(3)


def test_when_the_last_claim_has_ended_the_keeper_lets_go(
    reconciler: FakeReconciler, reconciling: ReconcileLoop
) -> None:
    reconciler.living = [claim()]
    reconciling.note_change()
    assert reconciler.await_rounds(2)
    with reconciler.done:
        reconciler.living = []
        rounds = reconciler.rounds
    assert reconciler.await_rounds(rounds + 1)
    assert not reconciler.await_rounds(rounds + 3, 0.3), "one may have begun before"


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
