# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The table of claims: events in the order of the changes, and leases."""

from __future__ import annotations

import contextlib
import json
import threading
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Iterator, List, Optional

import pytest
from clocks import HandClock, in_thread, join
from faulty_disk import kept_aside
from unit.manager.field import Field

from dyknow.errors import (
    Denied,
    HostError,
    InvalidTag,
    NoPlanFound,
    PeerTimeout,
    Result,
    SpawnFailed,
)
from dyknow.manager.claim import Claim, ClaimEvent, Moment
from dyknow.manager.claims.answers import StreamAnswers, refusal_of
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.store import Store
from dyknow.model.streams import ClaimState, StreamRequest

# The table of claims: events come in the order of the changes


def table() -> ClaimTable:
    return ClaimTable(Store(":memory:"), HandClock(), HandClock())


def active(claim_id: str, lease: float = 0.0) -> Claim:
    return Claim(claim_id, StreamRequest("A", lease=lease), "/a", state=ClaimState.ACTIVE)


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

    def work() -> None:
        for number in range(200):
            claims.change("a", "again", detail=f"{threading.get_ident()} {number}")

    join(*[in_thread(work) for _ in range(3)])
    claims.end("a", ClaimState.RELEASED, "released")
    assert len(events) == 602
    for before, after in zip(events[1:], events[2:]):
        assert after.before == before.after


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


class Leases:
    """Two claims with leases of 10 s, and the clocks of their manager."""

    def __init__(self) -> None:
        self.steady, self.running = HandClock(), HandClock()
        self.store = Store(":memory:")
        self.start()
        self.table.add(active("left", 10.0), "requested")
        self.table.add(active("renewed", 10.0), "requested")

    def start(self) -> None:
        """Start a manager on what the store has."""
        self.table = ClaimTable(self.store, self.steady, self.running)

    def pass_time(self, seconds: float, running: Optional[float] = None) -> None:
        """Let time pass, for which the manager runs as a whole or in part; it looks at the end."""
        self.steady.time += seconds
        self.running.time += seconds if running is None else running
        self.table.expire_late()


def test_a_lease_that_ended_while_the_manager_was_stopped_can_still_be_renewed() -> None:
    leases = Leases()
    leases.pass_time(30.0, running=0.3)
    leases.table.renew("renewed", 10.0)
    for _ in range(4):
        leases.pass_time(1.0)
    assert [each.claim_id for each in leases.table.living] == ["renewed"]


def test_a_lease_that_ended_without_a_manager_can_still_be_renewed() -> None:
    leases = Leases()
    leases.steady.time = leases.running.time = 100.0
    leases.start()
    leases.pass_time(0.0)
    leases.pass_time(2.0, running=0.5)
    leases.pass_time(8.5)
    leases.table.renew("renewed", 10.0)
    leases.pass_time(1.0)
    assert [each.claim_id for each in leases.table.living] == ["renewed"]


def test_a_lease_that_is_renewed_while_its_end_waits_is_not_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    leases = Leases()
    claims, turn = leases.table, leases.table._turn
    claims.end("left", ClaimState.RELEASED, "released")

    @contextlib.contextmanager
    def after_a_renewal() -> Iterator[None]:
        monkeypatch.setattr(claims, "_turn", turn)
        claims.renew("renewed", 10.0)
        with turn:
            yield

    monkeypatch.setattr(claims, "_turn", after_a_renewal())
    leases.pass_time(10.0)
    assert [each.deadline for each in claims.living] == [20.0]
    leases.pass_time(10.0)
    assert not claims.living


# Leases across the death of the manager: they go on, and never get longer


WRITTEN = Moment(steady=1000.0, wall=50_000.0, boot="first")
#: Its lease of ten seconds has eight left.
LEASED = replace(active("c", 10.0), deadline=WRITTEN.steady + 8.0)


@pytest.mark.parametrize(
    ("now", "expected"),
    [
        (Moment(1003.0, 50_003.0, "first"), 5.0),
        (Moment(1003.0, 90_000.0, "first"), 5.0),  # the clock was set
        (Moment(1003.0, 10.0, "first"), 5.0),
        (Moment(1100.0, 50_003.0, "first"), -92.0),
        (Moment(7.0, 50_003.0, "second"), 5.0),  # the machine was restarted
        (Moment(2000.0, 50_003.0, "second"), 5.0),
        (Moment(7.0, 10.0, "second"), 8.0),  # and has lost the time: no longer than it was
        (Moment(7.0, 50_003.0, ""), 5.0),
    ],
)
def test_a_lease_goes_on_whatever_happened_to_the_clocks(now: Moment, expected: float) -> None:
    deadline = Claim.from_body("c", LEASED.body(WRITTEN), now).deadline
    assert deadline is not None
    assert deadline - now.steady == pytest.approx(expected)


def test_a_lease_that_was_written_without_its_moment_is_as_long_as_it_was() -> None:
    body = json.loads(LEASED.body(WRITTEN))
    del body["written"]
    assert Claim.from_body("c", json.dumps(body), Moment(5.0, 1.0, "later")).deadline == 13.0


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


# Claims as shown to clients, and the causes of refusals

CLAIM = Claim(
    "id",
    StreamRequest("Position(ball)", client_id="me", lease=30.0),
    "/position",
    "std_msgs/Header",
    ClaimState.ACTIVE,
    "why",
    wiring={"/b": {}, "/a": {}},
    deadline=15.0,
)


@pytest.mark.parametrize(
    ("error", "result"),
    [
        (NoPlanFound("none", "id"), Result.NO_PLAN),
        (InvalidTag("x(", "expected more"), Result.INVALID_TAG),
        (Denied("x", "because"), Result.DENIED),
        (HostError("gone"), Result.SPAWN_FAILED),
        (ValueError("a fault of ours"), Result.SPAWN_FAILED),
    ],
)
def test_each_cause_has_its_number(error: Exception, result: Result) -> None:
    refusal = refusal_of(error)
    assert (refusal.result, str(refusal)) == (result, str(error))
    assert refusal.claim_id == ("id" if result is Result.NO_PLAN else "")


def test_a_cause_is_found_behind_others() -> None:
    late = HostError("not up in time")
    late.__cause__ = PeerTimeout("load", 10.0)
    wrapped = SpawnFailed("/a", late)
    wrapped.__cause__ = late
    assert refusal_of(wrapped).result is Result.TIMEOUT


def test_claims_and_events_are_shown_on_the_clock_of_the_clients() -> None:
    """The steady clock of the manager says 5, that of the clients 1000."""
    answers = StreamAnswers(lambda: 1000.0, lambda: 5.0)
    shown = answers.status(CLAIM)
    assert (shown.claim_id, shown.client_id, shown.tag) == ("id", "me", "Position(ball)")
    assert (shown.topic, shown.datatype) == ("/position", "std_msgs/Header")
    assert (shown.state, shown.detail) == (ClaimState.ACTIVE, "why")
    assert shown.nodelets == ("/a", "/b")
    assert shown.expires == 1010.0
    events = [ClaimEvent(before, CLAIM, "requested") for before in (None, CLAIM)]
    new, old = map(answers.event, events)
    assert new.before is None, "of a new claim"
    assert old.before == old.after == new.after == shown
    assert (new.reason, new.stamp) == ("requested", 1000.0)
