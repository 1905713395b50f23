# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""While a client's request is planned, streams are repaired; its plan is checked before use."""

from __future__ import annotations

import threading
from typing import Any, Callable, List, Optional

import pytest
from unit.manager.field import GOAL, Field, transformation

from dyknow.manager.planning.planner import Planner
from dyknow.model.streams import ClaimState, StreamRequest

#: Seconds after which a thread that does not end is a defect.
PATIENCE = 60.0


class Slow:
    """A planner that, on one thread, waits before it answers."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, method: str) -> None:
        self.is_planning = threading.Event()
        self.may_answer = threading.Event()
        self.calls = 0
        self._thread: Optional[threading.Thread] = None
        self._results: List[Any] = []
        plan = getattr(Planner, method)

        def slowly(*args: Any, **kwds: Any) -> Any:
            answer = plan(*args, **kwds)
            if threading.current_thread() is self._thread:
                self.calls += 1
                self.is_planning.set()
                assert self.may_answer.wait(PATIENCE)
            return answer

        monkeypatch.setattr(Planner, method, slowly)

    def start(self, request: Callable[[], Any]) -> None:
        def work() -> None:
            try:
                self._results.append(request())
            except Exception as error:
                self._results.append(error)

        self._thread = threading.Thread(target=work)
        self._thread.start()
        assert self.is_planning.wait(PATIENCE)

    def result(self) -> Any:
        self.may_answer.set()
        assert self._thread is not None
        self._thread.join(PATIENCE)
        (result,) = self._results
        return result


def dry_run(field: Field, claim_id: str) -> Any:
    return field.reconciler.acquire(StreamRequest(GOAL, budget=60.0), dry_run=True)


def acquire(field: Field, claim_id: str) -> Any:
    return field.acquire(GOAL, budget=60.0)


def replan(field: Field, claim_id: str) -> Any:
    return field.reconciler.replan(claim_id)


def dry_replan(field: Field, claim_id: str) -> Any:
    return field.reconciler.replan(claim_id, dry_run=True)


def find_bindings(field: Field, claim_id: str) -> Any:
    return field.reconciler.find_bindings("YUV(?where)")


@pytest.mark.parametrize("ask", [dry_run, acquire, replan, dry_replan, find_bindings])
def test_a_stream_is_repaired_while_a_client_waits_for_a_plan(
    field: Field, monkeypatch: pytest.MonkeyPatch, ask: Callable[[Field, str], Any]
) -> None:
    lost = field.acquire("YUV(field)").claim
    other = field.acquire("Planes(field)", exclude=("ceiling camera",)).claim
    slow = Slow(monkeypatch, "bindings" if ask is find_bindings else "plan")
    slow.start(lambda: ask(field, other.claim_id))
    field.host.vanish(lost.goal[0])
    field.tick()
    assert field.state(lost.claim_id) is ClaimState.ACTIVE
    assert field.claim(lost.claim_id).goal[0] in field.host.running
    assert not isinstance(slow.result(), Exception)
    field.settle()


def test_other_clients_are_served_while_one_waits_for_a_plan(
    field: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = Slow(monkeypatch, "plan")
    slow.start(lambda: acquire(field, ""))
    assert len(field.acquire("Planes(field)").spawned) == 2
    assert field.reconciler.find_bindings("YUV(?where)") == ([(("?where", "field"),)], True)
    assert slow.result().claim.state is ClaimState.ACTIVE


def test_a_plan_is_made_again_if_what_it_uses_has_gone(
    field: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = field.acquire("YUV(field)").claim
    slow = Slow(monkeypatch, "plan")
    slow.start(lambda: acquire(field, ""))
    field.manager.remove_transformation("bottom camera")
    field.host.vanish(camera.goal[0])
    field.tick()
    got = slow.result()
    assert slow.calls == 2
    assert "ceiling camera" in {field.manager.graph.get(name).label for name in got.claim.nodelets}
    field.settle()
    assert "it is whole again" not in field.reasons()


def test_a_refusal_is_checked_too(field: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    field.manager.remove_transformation("localization")
    slow = Slow(monkeypatch, "plan")
    slow.start(lambda: acquire(field, ""))
    field.manager.add_transformation(
        transformation(
            "localization",
            "soccer/Localization",
            "in ball, out position",
            f"ball RelativePosition(ball); position {GOAL}",
        )
    )
    assert slow.result().claim.state is ClaimState.ACTIVE
