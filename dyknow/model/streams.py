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
    """A client's request for a stream.

    Attributes:
        tag: a term, such as ``FieldPosition(ball)``.
        datatype: ROS type; empty for any.
        client_id: name of the client.
        request_id: the same request again gets the same claim; empty: every request is a new one.
        bond_id: the client's bond, which the manager watches; empty for none.
        lease: seconds until the claim ends unless it is renewed; 0 for until it is released.
        max_silence: seconds without a message after which a part counts as broken; 0: never.
        exclude: labels of transformations that must not be used.
        min_rate: Hz below which the stream is too slow; 0: any rate will do.
        max_age: seconds beyond which messages are too old when they are sent, by the stamps in
            their headers; 0: any age will do.
        prefer: concepts or labels of parts to use where there is a choice.
        avoid: concepts or labels of parts to use only where there is no choice.
        budget: seconds for the improvement of the plan; 0 for the default.
        require: a formula over ``it``, the stream's messages, that has to be TRUE.
    """

    tag: str
    datatype: str = ""
    client_id: str = ""
    request_id: str = ""
    bond_id: str = ""
    lease: float = 0.0
    max_silence: float = 0.0
    exclude: Tuple[str, ...] = ()
    min_rate: float = 0.0
    max_age: float = 0.0
    prefer: Tuple[str, ...] = ()
    avoid: Tuple[str, ...] = ()
    budget: float = 0.0
    require: str = ""


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
    """A change of a claim.

    Attributes:
        stamp: ROS time in seconds.
        before: the claim as it was; None for a new one.
        after: the claim as it is.
        reason: cause of the change.
    """

    stamp: float
    before: Optional[StreamStatus]
    after: StreamStatus
    reason: str


@dataclass(frozen=True)
class Acquisition:
    """Answer to ``acquire_stream``; the fields are those of the service.

    Attributes:
        message: the detail of the claim.
        warnings: probable mistakes; in the service they are lines of the message.
        bindings: values of the tag's variables, each as ``?camera=left``.
        least_cost: no plan costs less; if it is the cost, the plan is proven to cost least.
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
    bindings: Tuple[str, ...] = ()
    least_cost: float = 0.0


@dataclass(frozen=True)
class Replanned:
    """Answer to ``replan_stream``; the fields are those of the service."""

    spawned: Tuple[str, ...]
    reused: Tuple[str, ...]
    cost: float
    plan: str
    message: str
