"""Streams on request, as values."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Tuple


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
