"""Claims as messages."""

from __future__ import annotations

import time
from typing import Callable

import rospy
from dyknow_msgs.msg import StreamEvent, StreamStatus

from dyknow.manager.claim import Claim, ClaimEvent


class StreamMessages:
    """Makes messages of claims, whose leases run on steady time."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Read leases on ``clock``, which is the reconciler's."""
        self._clock = clock

    def status(self, claim: Claim) -> StreamStatus:
        """Convert a claim."""
        return StreamStatus(
            claim_id=claim.claim_id,
            client_id=claim.request.client_id,
            tag=claim.request.tag,
            topic=claim.topic,
            datatype=claim.datatype,
            state=int(claim.state),
            detail=claim.detail,
            nodelets=list(claim.nodelets),
            expires=self.expires(claim),
        )

    def event(self, event: ClaimEvent, is_new: bool) -> StreamEvent:
        """Convert a change of a claim; a new one was nothing before."""
        return StreamEvent(
            stamp=rospy.Time.now(),
            before=StreamStatus() if is_new else self.status(event.before),
            after=self.status(event.after),
            reason=event.reason,
        )

    def expires(self, claim: Claim) -> rospy.Time:
        """Tell in ROS time when the lease ends; zero for never."""
        if claim.deadline is None:
            return rospy.Time()
        left = max(0.0, claim.deadline - self._clock())
        return rospy.Time.now() + rospy.Duration.from_sec(left)
