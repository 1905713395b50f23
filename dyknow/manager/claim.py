"""Claims: streams that clients asked for, as values."""

from __future__ import annotations

import enum
from dataclasses import asdict, dataclass, field
from typing import Any, Dict, Mapping, Optional, Tuple

from dyknow.manager.moment import Moment
from dyknow.manager.specifications.tags import parse_tag
from dyknow.manager.well_typed import check_types


class ClaimState(enum.IntEnum):
    """State of a claim; the numbers are those of ``dyknow_msgs/StreamStatus``."""

    PENDING = 0
    ACTIVE = 1
    DEGRADED = 2
    RECOVERING = 3
    FAILED = 4
    RELEASED = 5
    EXPIRED = 6

    @property
    def ended(self) -> bool:
        """Whether nothing will come of it any more."""
        return self in (ClaimState.RELEASED, ClaimState.EXPIRED)


NO_MESSAGE = "no message yet"
"""Detail of an active claim on whose topic nothing has come since its stream was changed last."""


@dataclass(frozen=True)
class StreamRequest:
    """What a client asks for.

    Attributes:
        tag: a term, such as ``FieldPosition(ball)``.
        datatype: ROS type; empty for any.
        client_id: who asks.
        request_id: the same request again gets the same claim; empty: every request is a new one.
        bond_id: bond of the client, for whoever watches it; empty: there is none.
        lease: seconds until the claim ends unless it is renewed; 0 for until it is released.
        max_silence: seconds without a message after which a part counts as broken; 0: never.
        exclude: labels of transformations that must not be used.
    """

    tag: str
    datatype: str = ""
    client_id: str = ""
    request_id: str = ""
    bond_id: str = ""
    lease: float = 0.0
    max_silence: float = 0.0
    exclude: Tuple[str, ...] = ()


@dataclass(frozen=True)
class Claim:
    """A stream that is kept for a client.

    Attributes:
        claim_id: names the claim.
        request: what was asked for.
        topic: where the client listens; it stays, whoever publishes there.
        datatype: type of the stream.
        state: whether it flows.
        detail: why it does not, or what is not known to flow yet, in words.
        goal: nodelet and out-port that publish; empty for a topic of ordinary nodes.
        wiring: for each nodelet of the stream the topics that its ports need; while there is no
            stream, the nodelets that are kept for it, connected to nothing.
        sources: topics of ordinary nodes that the stream needs.
        deadline: when the lease ends, on the reconciler's clock; None for never.
    """

    claim_id: str
    request: StreamRequest
    topic: str = ""
    datatype: str = ""
    state: ClaimState = ClaimState.PENDING
    detail: str = ""
    goal: Tuple[str, str] = ("", "")
    wiring: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    sources: Tuple[str, ...] = ()
    deadline: Optional[float] = None

    @property
    def is_made(self) -> bool:
        """Whether something was made, or found, that is to publish for it."""
        return bool(self.goal[0] or self.sources)

    @property
    def nodelets(self) -> Tuple[str, ...]:
        """Nodelets of the stream, by name."""
        return tuple(sorted(self.wiring))

    def body(self, now: Moment) -> Dict[str, Any]:
        """Write the claim for the store; the lease as what is left of it, and since when."""
        body = asdict(self)
        body["state"] = int(self.state)
        body["left"] = None if self.deadline is None else self.deadline - now.steady
        body["written"] = asdict(now)
        del body["deadline"]
        return body

    @classmethod
    def from_body(cls, body: Mapping[str, Any], now: Moment) -> Claim:
        """Read what ``body`` wrote; the lease has gone on meanwhile.

        Raises:
            KeyError, TypeError, ValueError, InvalidTag: it is something else.
        """
        fields = dict(body)
        left = fields.pop("left")
        written = Moment(**fields.pop("written", asdict(now)))
        check_types(written)
        request = dict(fields.pop("request"))
        request["exclude"] = tuple(request["exclude"])
        claim = cls(
            **{
                **fields,
                "request": StreamRequest(**request),
                "state": ClaimState(fields["state"]),
                "goal": tuple(fields["goal"]),
                "sources": tuple(fields["sources"]),
                "deadline": None if left is None else now.steady + left - now.since(written),
            }
        )
        check_types(claim)
        parse_tag(claim.request.tag)
        return claim


@dataclass(frozen=True)
class ClaimEvent:
    """A claim changed."""

    before: Claim
    after: Claim
    reason: str
