# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The streams of the node dyknow_manager.

Ownership: ``StreamNode`` owns the thread that reconciles claims, the bonds with clients, the
services and the topic of events.
"""

from __future__ import annotations

from typing import Callable, Set

import rospy
from dyknow_msgs.msg import StreamEvent

from dyknow.manager.claim import ClaimEvent
from dyknow.manager.claims.answers import StreamAnswers
from dyknow.manager.claims.reconciler import StreamReconciler
from dyknow.manager.manager import Manager
from dyknow.periodic import in_background
from dyknow.ros.bonding.claim_bonds import ClaimBonds
from dyknow.ros.manager.loops import ReconcileLoop
from dyknow.ros.manager.services import StreamServices
from dyknow.ros.wire.messages import event_message

#: Events that may wait for a slow subscriber.
_QUEUE_SIZE = 1000
#: Seconds to wait, at the end, for a repair that is going on.
_END_PATIENCE = 3.0


class StreamNode:
    """Connects the reconciler of claims with ROS; the manager must have been started."""

    def __init__(
        self,
        manager: Manager,
        reconciler: StreamReconciler,
        after_change: Callable[[], None],
        running: Callable[[], float],
    ) -> None:
        """Take over the claims of an earlier life, and offer the services.

        Args:
            manager: makes and destroys nodelets.
            reconciler: keeps the claims; made before the manager was started.
            after_change: called after each attempt to change something, before it is answered.
            running: time for which this process has run, in seconds.
        """
        self._manager = manager
        self._answers = StreamAnswers(rospy.get_time)
        self._publisher = rospy.Publisher("~stream_events", StreamEvent, queue_size=_QUEUE_SIZE)
        self._reconciler = reconciler
        self._known: Set[str] = {claim.claim_id for claim in self._reconciler.claims()}
        self._bonds = ClaimBonds(self._reconciler.claims, self._reconciler.expire, running)
        self._reconciling = ReconcileLoop(self._reconciler, self._has_work)
        self._reconciler.on_event = self._on_event
        if manager.store.complaint:
            self._reconciler.report(manager.store.complaint)
        self._bonds.follow()
        self._services = StreamServices(manager, reconciler, self._answers, after_change)
        self._reconciling.start()

    def note_change(self) -> None:
        """Ask for a round, since the graph or the library changed; does not wait."""
        self._reconciling.note_change()

    def close(self) -> None:
        """End all claims; the nodelets of the streams are not touched."""
        self._services.close()
        self._reconciling.close(1.0)
        # The end of a repair that is going on is awaited, but not for long.
        in_background("ending the claims", self._reconciler.end).join(_END_PATIENCE)
        self._bonds.close()  # the topic is withdrawn with the node, when the last is sent

    def suspend(self) -> None:
        """Do nothing more for the claims, and leave them as they are."""
        self._services.close()
        self._reconciling.close(_END_PATIENCE)
        self._bonds.close()

    def _has_work(self) -> bool:
        return any(not claim.state.ended for claim in self._reconciler.claims()) or any(
            record.claimed for record in self._manager.graph.all()
        )

    def _on_event(self, event: ClaimEvent) -> None:
        is_new = event.after.claim_id not in self._known
        self._known.add(event.after.claim_id)
        if event.after.state.ended:
            self._known.discard(event.after.claim_id)
        rospy.loginfo(
            "stream %s, %s: %s: %s",
            event.after.claim_id,
            event.after.request.tag,
            event.after.state.name,
            event.reason,
        )
        self._publisher.publish(event_message(self._answers.event(event, is_new)))
        self._bonds.follow()
        self._reconciling.note_change()
