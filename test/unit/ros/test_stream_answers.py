"""Answers about streams: causes as numbers, claims as messages and back."""

from __future__ import annotations

import pytest
from dyknow_msgs.srv import AcquireStreamResponse

from dyknow.errors import Denied, HostError, InvalidTag, NoPlanFound, PeerTimeout, SpawnFailed
from dyknow.manager.claim import Claim, ClaimEvent
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.ros.client_errors import Result, StreamRefused
from dyknow.ros.manager.stream_messages import StreamMessages
from dyknow.ros.manager.stream_services import _result
from dyknow.ros.stream_views import acquired_view, event_view, stream_view, with_warnings


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    import rospy

    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time(1000)))


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


def test_numbers_are_those_of_the_messages() -> None:
    for result in Result:
        assert getattr(AcquireStreamResponse, result.name) == result


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
    assert _result(error) == result


def test_a_cause_is_found_behind_others() -> None:
    try:
        try:
            raise PeerTimeout("load", 10.0)
        except PeerTimeout as cause:
            raise HostError("not up in time") from cause
    except HostError as late:
        wrapped = SpawnFailed("/a", late)
        wrapped.__cause__ = late
    assert _result(wrapped) == Result.TIMEOUT


def test_a_claim_there_and_back() -> None:
    view = stream_view(StreamMessages(lambda: 5.0).status(CLAIM))
    assert (view.claim_id, view.client_id, view.tag) == ("id", "me", "Position(ball)")
    assert (view.topic, view.datatype) == ("/position", "std_msgs/Header")
    assert (view.state, view.detail) == (ClaimState.ACTIVE, "why")
    assert view.nodelets == ("/a", "/b")
    assert view.expires == 1010.0


def test_an_event_of_a_new_claim_has_nothing_before() -> None:
    messages = StreamMessages(lambda: 5.0)
    event = ClaimEvent(CLAIM, CLAIM, "requested")
    new, old = (event_view(messages.event(event, is_new)) for is_new in (True, False))
    assert new.before is None
    assert old.before == old.after == new.after
    assert new.reason == "requested"


def test_no_is_an_exception() -> None:
    answer = AcquireStreamResponse(result=Result.NO_PLAN, message="none", claim_id="waiting")
    with pytest.raises(StreamRefused, match="none") as caught:
        acquired_view(answer)
    assert (caught.value.result, caught.value.claim_id) == (Result.NO_PLAN, "waiting")


@pytest.mark.parametrize("detail", ["", "no message yet"])
@pytest.mark.parametrize("warnings", [(), ("no transformation is labelled 'x'", "nor 'y'")])
def test_warnings_of_an_answer_are_no_detail_of_the_claim(
    detail: str, warnings: tuple[str, ...]
) -> None:
    message = with_warnings(detail, warnings)
    found = acquired_view(AcquireStreamResponse(success=True, message=message))
    assert (found.message, found.warnings) == (detail, warnings)
