"""What the manager answers about streams, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Optional, Sequence, Tuple

from dyknow_msgs.msg import StreamEvent, StreamStatus

from dyknow.model.streams import ClaimState
from dyknow.ros.client_errors import Result, StreamRefused

#: Begins the lines of a message that are no detail of the claim.
WARNING = "warning: "


@dataclass(frozen=True)
class StreamView:
    """A claim as the manager shows it; the fields are those of ``dyknow_msgs/StreamStatus``.

    ``expires`` is in seconds of ROS time, 0 for until released.
    """

    claim_id: str
    client_id: str
    tag: str
    topic: str
    datatype: str
    state: ClaimState
    detail: str
    nodelets: Tuple[str, ...]
    expires: float


@dataclass(frozen=True)
class StreamEventView:
    """A change of a claim.

    Attributes:
        stamp: ROS time in seconds.
        before: the claim as it was; None for a new one.
        after: the claim as it is.
        reason: what brought the change about.
    """

    stamp: float
    before: Optional[StreamView]
    after: StreamView
    reason: str


@dataclass(frozen=True)
class AcquiredView:
    """Answer to ``acquire_stream``; the fields are those of the service.

    Attributes:
        message: the detail of the claim.
        warnings: what is probably not meant; in the service they are lines of the message.
    """

    claim_id: str
    topic: str
    datatype: str
    spawned: Tuple[str, ...]
    reused: Tuple[str, ...]
    cost: float
    expires: float
    plan: str
    message: str
    warnings: Tuple[str, ...] = ()


@dataclass(frozen=True)
class ReplannedView:
    """Answer to ``replan_stream``; the fields are those of the service."""

    spawned: Tuple[str, ...]
    reused: Tuple[str, ...]
    cost: float
    plan: str
    message: str


def with_warnings(detail: str, warnings: Sequence[str]) -> str:
    """Write the message of an answer that is yes, which ``acquired_view`` takes apart."""
    return "\n".join([*filter(None, [detail]), *(WARNING + each for each in warnings)])


def stream_view(message: StreamStatus) -> StreamView:
    """Read a claim."""
    return StreamView(
        message.claim_id,
        message.client_id,
        message.tag,
        message.topic,
        message.datatype,
        ClaimState(message.state),
        message.detail,
        tuple(message.nodelets),
        message.expires.to_sec(),
    )


def event_view(message: StreamEvent) -> StreamEventView:
    """Read an event."""
    return StreamEventView(
        message.stamp.to_sec(),
        stream_view(message.before) if message.before.claim_id else None,
        stream_view(message.after),
        message.reason,
    )


def acquired_view(answer: Any) -> AcquiredView:
    """Read an answer of ``acquire_stream``.

    Raises:
        StreamRefused: it is no.
    """
    if not answer.success:
        raise StreamRefused(answer.message, Result(answer.result), answer.claim_id)
    lines = answer.message.splitlines()
    return AcquiredView(
        answer.claim_id,
        answer.topic,
        answer.datatype,
        tuple(answer.spawned),
        tuple(answer.reused),
        answer.cost,
        answer.expires.to_sec(),
        answer.plan,
        "\n".join(line for line in lines if not line.startswith(WARNING)),
        tuple(line[len(WARNING) :] for line in lines if line.startswith(WARNING)),
    )


def replanned_view(answer: Any) -> ReplannedView:
    """Read an answer of ``replan_stream`` that is yes."""
    return ReplannedView(
        tuple(answer.spawned), tuple(answer.reused), answer.cost, answer.plan, answer.message
    )
