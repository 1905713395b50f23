# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The table of claims: events come in the order of the changes."""

from __future__ import annotations

import contextlib
import threading
from typing import List

from dyknow.manager.claim import Claim, ClaimEvent
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.store import Store
from dyknow.model.streams import ClaimState, StreamRequest


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
