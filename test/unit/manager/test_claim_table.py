# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The table of claims: events in the order of the changes, and leases."""

from __future__ import annotations

import contextlib
import json
import threading
from contextlib import closing
from pathlib import Path
from typing import List

import pytest
from faulty_disk import kept_aside
from unit.manager.field import Field

from dyknow.manager.claim import Claim, ClaimEvent, Moment
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.store import Store
from dyknow.model.streams import ClaimState, StreamRequest

# The table of claims: events come in the order of the changes


def table() -> ClaimTable:
    return ClaimTable(Store(":memory:"), lambda: 0.0, lambda: 0.0)


def active(claim_id: str) -> Claim:
    return Claim(claim_id, StreamRequest("A"), "/a", state=ClaimState.ACTIVE)


def test_a_claim_that_is_released_while_its_making_is_told_is_told_released_afterwards() -> None:
    claims = table()
    told: List[ClaimState] = []
    telling, released = threading.Event(), threading.Event()

    def listen(event: ClaimEvent) -> None:
        if event.after.state is ClaimState.ACTIVE:
            telling.set()
            assert released.wait(20.0)
        told.append(event.after.state)

    claims.events.listener = listen
    maker = threading.Thread(target=claims.add, args=(active("a"), "requested"))
    maker.start()
    assert telling.wait(20.0)
    claims.end("a", ClaimState.RELEASED, "released")
    released.set()
    maker.join(20.0)
    assert told == [ClaimState.ACTIVE, ClaimState.RELEASED]


def test_each_event_begins_where_the_one_before_ended_whoever_changes_claims() -> None:
    claims = table()
    events: List[ClaimEvent] = []
    at_once = threading.Lock()

    def listen(event: ClaimEvent) -> None:
        assert at_once.acquire(blocking=False), "one at a time"
        events.append(event)
        at_once.release()

    claims.events.listener = listen
    claims.add(active("a"), "requested")

    def work(name: str) -> None:
        for number in range(200):
            claims.change("a", "again", detail=f"{name} {number}")

    threads = [threading.Thread(target=work, args=(name,)) for name in "xyz"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    claims.end("a", ClaimState.RELEASED, "released")
    assert len(events) == 602
    for before, after in zip(events[1:], events[2:]):
        assert after.before == before.after


def test_who_changes_a_claim_when_told_of_it_is_told_of_that_next() -> None:
    claims = table()
    told: List[ClaimState] = []

    def listen(event: ClaimEvent) -> None:
        told.append(event.after.state)
        claims.end("a", ClaimState.EXPIRED, "its client is gone")

    claims.events.listener = listen
    claims.add(active("a"), "requested")
    assert told == [ClaimState.ACTIVE, ClaimState.EXPIRED]


def test_a_listener_that_raises_does_not_silence_the_others() -> None:
    claims = table()
    told: List[str] = []

    def listen(event: ClaimEvent) -> None:
        told.append(event.after.detail)
        if event.after.detail == "bad":
            raise ValueError

    claims.events.listener = listen
    claims.add(active("a"), "requested")
    with contextlib.suppress(ValueError):
        claims.change("a", "", detail="bad")
    claims.change("a", "", detail="good")
    assert told == ["", "bad", "good"]


def test_a_lease_that_ended_while_the_manager_was_stopped_can_still_be_renewed() -> None:
    steady, running = [0.0], [0.0]
    claims = ClaimTable(Store(":memory:"), lambda: steady[0], lambda: running[0])
    for claim_id in ("left", "renewed"):
        request = StreamRequest("A", lease=10.0)
        claims.add(Claim(claim_id, request, "/a", state=ClaimState.ACTIVE), "requested")
    steady[0] = 30.0  # it was stopped
    running[0] = 0.3
    claims.expire_late()
    claims.renew("renewed", 10.0)
    for _ in range(4):
        steady[0] += 1.0
        running[0] += 1.0
        claims.expire_late()
    assert [each.claim_id for each in claims.living] == ["renewed"]


# Leases across the death of the manager: they go on, and never get longer


WRITTEN = Moment(steady=1000.0, wall=50_000.0, boot="first")


def left(now: Moment) -> float:
    """Rest of a lease of ten seconds that was stored with eight left."""
    claim = Claim("c", StreamRequest("T(a)", lease=10.0), deadline=WRITTEN.steady + 8.0)
    deadline = Claim.from_body("c", claim.body(WRITTEN), now).deadline
    assert deadline is not None
    return deadline - now.steady


@pytest.mark.parametrize(
    ("now", "expected"),
    [
        (Moment(1003.0, 50_003.0, "first"), 5.0),
        (Moment(1003.0, 90_000.0, "first"), 5.0),  # somebody set the clock
        (Moment(1003.0, 10.0, "first"), 5.0),
        (Moment(1100.0, 50_003.0, "first"), -92.0),
        (Moment(7.0, 50_003.0, "second"), 5.0),  # the machine was restarted
        (Moment(2000.0, 50_003.0, "second"), 5.0),
        (Moment(7.0, 10.0, "second"), 8.0),  # and has lost the time: no longer than it was
        (Moment(7.0, 50_003.0, ""), 5.0),
    ],
)
def test_a_lease_goes_on_whatever_happened_to_the_clocks(now: Moment, expected: float) -> None:
    assert left(now) == pytest.approx(expected)


def test_a_lease_that_was_written_without_its_moment_is_as_long_as_it_was() -> None:
    claim = Claim("c", StreamRequest("T(a)", lease=10.0), deadline=1008.0)
    body = json.loads(claim.body(WRITTEN))
    del body["written"]
    assert Claim.from_body("c", json.dumps(body), Moment(5.0, 1.0, "later")).deadline == 13.0


def test_a_lease_goes_on_while_the_manager_is_dead(tmp_path: Path) -> None:
    field = Field(str(tmp_path / "state"))
    claim = field.acquire(lease=20.0).claim
    assert claim.deadline is not None
    field.settle(4.0)
    field.store.close()
    field.clock.time += 6.0
    field.open()
    assert field.reconciler.claims()[0].deadline == pytest.approx(claim.deadline)
    field.settle(9.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    field.settle(2.0)
    assert field.state(claim.claim_id) is ClaimState.EXPIRED


@pytest.mark.parametrize(
    "change",
    [
        {"claim_id": "other"},
        {"state": 9},
        {"left": "long"},
        {"left": float("nan")},
        {"wiring": {"/n": "in"}},
        {"written": {"steady": "x"}},
        {"written": {"steady": "x", "wall": 1.0, "boot": ""}},
        {"request": {}},
        {"request": {"tag": "T("}},
        {"goal": ["/n"]},
        {"surprise": 1},
    ],
)
def test_a_claim_that_means_nothing_is_set_aside_and_the_others_are_kept(
    tmp_path: Path, change: dict[str, object]
) -> None:
    path = str(tmp_path / "state")
    field = Field(path)
    claim = field.acquire(lease=20.0).claim
    field.store.close()
    body = json.dumps({**json.loads(claim.body(WRITTEN)), "claim_id": "bad", **change})
    with closing(Store(path)) as file:
        file.write({("claims", "bad"): body})
    field.open()
    assert [each.claim_id for each in field.reconciler.claims()] == [claim.claim_id]
    assert "claims 'bad'" in field.store.complaint
    (aside,) = kept_aside(path)
    assert json.loads(aside.read_text())[0]["key"] == "bad"


def test_clients_hear_that_a_backup_took_the_place_of_the_state(tmp_path: Path) -> None:
    path = tmp_path / "state"
    field = Field(str(path))
    claim = field.acquire().claim
    field.store.close()
    data = path.read_bytes()
    assert data.count(b"FieldPosition(ball)")
    path.write_bytes(data.replace(b"FieldPosition(ball)", b"FieldPosition(bull)"))
    field.open()
    assert "backup" in field.store.complaint
    field.reconciler.report(field.store.complaint)
    assert [each.after.claim_id for each in field.events] == [claim.claim_id]
    assert field.reasons() == [field.store.complaint]
    field.settle()
    assert field.claim(claim.claim_id).request.tag == "FieldPosition(ball)"
