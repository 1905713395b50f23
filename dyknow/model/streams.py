# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Streams on request, as values."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Optional, Tuple


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
        """True once the claim is RELEASED or EXPIRED."""
        return self in (ClaimState.RELEASED, ClaimState.EXPIRED)


NO_MESSAGE = "no message yet"
"""Detail of an active claim on whose topic nothing has come since its stream was changed last."""

UNKNOWN_AGE = "not known how old messages are: they bear no stamp, or no process reports it"
"""Detail of an active claim with a ``max_age`` that cannot be judged."""


@dataclass(frozen=True)
class StreamRequest:
    """A client's request for a stream."""

    tag: str  #: a term, such as ``FieldPosition(ball)``
    datatype: str = ""  #: ROS type; empty for any
    client_id: str = ""  #: name of the client
    #: The same request again gets the same claim; empty: every request is a new one.
    request_id: str = ""
    bond_id: str = ""  #: the client's bond, which the manager watches; empty for none
    #: Seconds until the claim ends unless it is renewed; 0 for until it is released.
    lease: float = 0.0
    #: Seconds without a message after which a part counts as broken; 0: never.
    max_silence: float = 0.0
    exclude: Tuple[str, ...] = ()  #: labels of transformations that must not be used
    min_rate: float = 0.0  #: Hz below which the stream is too slow; 0: any rate will do
    #: Seconds beyond which messages are too old when they are sent, by the stamps in their
    #: headers; 0: any age will do.
    max_age: float = 0.0
    prefer: Tuple[str, ...] = ()  #: concepts or labels of parts to use where there is a choice
    #: Concepts or labels of parts to use only where there is no choice.
    avoid: Tuple[str, ...] = ()
    budget: float = 0.0  #: seconds for the improvement of the plan; 0 for the default
    require: str = ""  #: a formula over ``it``, the stream's messages, that has to be TRUE


@dataclass(frozen=True)
class StreamStatus:
    """A claim as the manager shows it; the fields are those of ``dyknow_msgs/StreamStatus``.

    ``expires`` is in seconds of ROS time, 0 for until released; ``bindings`` has the
    values of the tag's variables, each as ``?camera=left``.
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
    bindings: Tuple[str, ...] = ()

    @property
    def bound_tag(self) -> str:
        """The tag and the values of its variables: ``Image(?camera) ?camera=left``."""
        return " ".join([self.tag, *self.bindings])


@dataclass(frozen=True)
class StreamEvent:
    """A change of a claim."""

    stamp: float  #: ROS time in seconds
    before: Optional[StreamStatus]  #: the claim as it was; None for a new one
    after: StreamStatus  #: the claim as it is
    reason: str  #: cause of the change


@dataclass(frozen=True)
class Acquisition:
    """Answer to ``acquire_stream``; the fields are those of the service."""

    claim_id: str
    topic: str
    datatype: str
    spawned: Tuple[str, ...]
    reused: Tuple[str, ...]
    cost: float
    expires: float
    plan: str
    message: str  #: the detail of the claim
    #: Probable mistakes; in the service they are lines of the message.
    warnings: Tuple[str, ...] = ()
    bindings: Tuple[str, ...] = ()  #: values of the tag's variables, each as ``?camera=left``
    #: No plan costs less; if it is the cost, the plan is proven to cost least.
    least_cost: float = 0.0


@dataclass(frozen=True)
class Replanned:
    """Answer to ``replan_stream``; the fields are those of the service."""

    spawned: Tuple[str, ...]
    reused: Tuple[str, ...]
    cost: float
    plan: str
    message: str
