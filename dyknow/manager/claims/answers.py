# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What clients see of claims, as values."""

from __future__ import annotations

import time
from typing import Callable, Optional, Sequence, Tuple, Type

from dyknow.errors import (
    Denied,
    DyKnowError,
    InvalidTag,
    LimitExceeded,
    NoPlanFound,
    PeerTimeout,
    Result,
    StreamRefused,
    StreamTypeMismatch,
)
from dyknow.manager.claim import Claim, ClaimEvent
from dyknow.manager.claims.reconciler import Acquired
from dyknow.manager.planning.explanation import as_tree
from dyknow.manager.specifications.tags import written_bindings
from dyknow.model.streams import Acquisition, Replanned, StreamEvent, StreamStatus

_RESULTS: Tuple[Tuple[Type[DyKnowError], Result], ...] = (
    (NoPlanFound, Result.NO_PLAN),
    (InvalidTag, Result.INVALID_TAG),
    (StreamTypeMismatch, Result.TYPE_MISMATCH),
    (PeerTimeout, Result.TIMEOUT),
    (Denied, Result.DENIED),
    (LimitExceeded, Result.DENIED),
)


class StreamAnswers:
    """Makes the values that clients get; converts lease times from steady time to their clock."""

    def __init__(
        self, now: Callable[[], float], clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Convert times of ``clock``, the reconciler's, to times of ``now``.

        Args:
            now: seconds on the clients' clock, such as ROS time.
            clock: seconds, steady.
        """
        self._now = now
        self._clock = clock

    def status(self, claim: Claim) -> StreamStatus:
        """Return the status of a claim."""
        return StreamStatus(
            claim.claim_id,
            claim.request.client_id,
            claim.request.tag,
            claim.topic,
            claim.datatype,
            claim.state,
            claim.detail,
            claim.nodelets,
            self.expires(claim),
            _written(claim),
        )

    def expires(self, claim: Claim) -> float:
        """Return when the lease ends, in seconds on the clients' clock; 0 for never."""
        if claim.deadline is None:
            return 0.0
        return self._now() + max(0.0, claim.deadline - self._clock())

    def event(self, event: ClaimEvent, is_new: bool) -> StreamEvent:
        """Return the event for a change; a new claim has no state before it."""
        before = None if is_new else self.status(event.before)
        return StreamEvent(self._now(), before, self.status(event.after), event.reason)

    def acquisition(self, acquired: Acquired, warnings: Sequence[str]) -> Acquisition:
        """Return the answer to a request for a stream."""
        claim, plan = acquired.claim, self.replanned(acquired)
        return Acquisition(
            claim.claim_id,
            claim.topic,
            claim.datatype,
            plan.spawned,
            plan.reused,
            plan.cost,
            self.expires(claim),
            plan.plan,
            plan.message,
            tuple(warnings),
            _written(claim),
            0.0 if acquired.plan is None else float(acquired.plan.least_cost),
        )

    def replanned(self, acquired: Acquired) -> Replanned:
        """Return the answer to a request to plan a stream again."""
        return Replanned(
            tuple(sorted(acquired.spawned)),
            tuple(sorted(acquired.reused)),
            float(acquired.cost),
            "" if acquired.plan is None else as_tree(acquired.plan),
            acquired.claim.detail,
        )


def _written(claim: Claim) -> Tuple[str, ...]:
    return tuple(written_bindings((each,)) for each in claim.bindings)


def refusal_of(error: BaseException) -> StreamRefused:
    """Return the refusal for an error, or for the error that caused it."""
    cause: Optional[BaseException] = error
    while cause is not None:
        for kind, result in _RESULTS:
            if isinstance(cause, kind):
                return StreamRefused(str(error), result, getattr(error, "claim_id", ""))
        cause = cause.__cause__
    return StreamRefused(str(error), Result.SPAWN_FAILED, getattr(error, "claim_id", ""))
