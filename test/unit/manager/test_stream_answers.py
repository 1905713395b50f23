# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claims as shown to clients, and the causes of refusals."""

from __future__ import annotations

import pytest

from dyknow.errors import (
    Denied,
    HostError,
    InvalidTag,
    NoPlanFound,
    PeerTimeout,
    Result,
    SpawnFailed,
)
from dyknow.manager.claim import Claim, ClaimEvent
from dyknow.manager.claims.answers import StreamAnswers, refusal_of
from dyknow.model.streams import ClaimState, StreamRequest

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


def answers() -> StreamAnswers:
    """Answers of a manager whose steady clock says 5 and whose clients' says 1000."""
    return StreamAnswers(lambda: 1000.0, lambda: 5.0)


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
    try:
        try:
            raise PeerTimeout("load", 10.0)
        except PeerTimeout as cause:
            raise HostError("not up in time") from cause
    except HostError as late:
        wrapped = SpawnFailed("/a", late)
        wrapped.__cause__ = late
    assert refusal_of(wrapped).result is Result.TIMEOUT


def test_a_claim_is_shown_on_the_clock_of_its_clients() -> None:
    shown = answers().status(CLAIM)
    assert (shown.claim_id, shown.client_id, shown.tag) == ("id", "me", "Position(ball)")
    assert (shown.topic, shown.datatype) == ("/position", "std_msgs/Header")
    assert (shown.state, shown.detail) == (ClaimState.ACTIVE, "why")
    assert shown.nodelets == ("/a", "/b")
    assert shown.expires == 1010.0


def test_an_event_of_a_new_claim_has_nothing_before() -> None:
    event = ClaimEvent(CLAIM, CLAIM, "requested")
    new, old = (answers().event(event, is_new) for is_new in (True, False))
    assert new.before is None
    assert old.before == old.after == new.after
    assert (new.reason, new.stamp) == ("requested", 1000.0)
