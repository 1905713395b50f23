# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The periodic work of the node: observing processes, keeping claims, publishing the model.

Each has a thread of its own, since a plan may take seconds and a process may not answer.
"""

from __future__ import annotations

import collections
from typing import Callable, Deque, Optional, Set, Tuple

import rospy
from dyknow_msgs.msg import Model as ModelMessage

from dyknow.locks import turn_lock
from dyknow.manager.claims.reconciler import StreamReconciler
from dyknow.manager.manager import Manager
from dyknow.model.graph import Model
from dyknow.periodic import PAUSE, STEADY, Clock, PeriodicWorker
from dyknow.ros.wire.model_messages import ModelMessages

#: Seconds between two looks, and between two rounds over the claims, when nothing happens.
PERIOD = 0.5
#: Rounds over the claims in the ``max_silence`` of one of them.
_ROUNDS = 4
#: Least seconds between two messages with the model.
_MODEL_PERIOD = 0.05


class Watch:
    """Has the manager observe its processes: every half second, and at once after an event."""

    def __init__(self, manager: Manager, after: Callable[[], None], clock: Clock = STEADY) -> None:
        """Prepare; ``start`` starts the thread, which calls ``after`` after each look."""
        self._manager = manager
        self._after = after
        self._changed: Deque[str] = collections.deque()
        self._postponed: Set[str] = set()
        self._worker = PeriodicWorker(
            "looking at the nodelet managers",
            self._look,
            lambda: PAUSE if self._postponed else PERIOD,
            clock=clock,
        )
        self.start = self._worker.start
        self.refresh_now = self._worker.wake
        self.close = self._worker.close

    def refresh(self, name: str) -> None:
        """Request a look that asks a nodelet for its ports; does not wait."""
        self._changed.append(name)
        self._worker.wake()

    def _look(self) -> None:
        changed = self._postponed
        while self._changed:
            changed.add(self._changed.popleft())
        # This look skips busy nodelets, so the next one has to ask for their ports.
        self._postponed = {name for name in changed if self._manager.graph.is_busy(name)}
        try:
            self._manager.look(changed)
        finally:
            self._after()


class ReconcileLoop:
    """Reconciles the claims: periodically while there are any, and soon after changes."""

    def __init__(
        self,
        reconciler: StreamReconciler,
        has_work: Callable[[], bool],
        clock: Clock = STEADY,
    ) -> None:
        """Prepare; ``start`` starts the thread.

        Args:
            reconciler: keeps the claims.
            has_work: whether there are claims, or nodelets of claims; if not, the next round comes
                after the next change.
            clock: steady time.
        """
        self._reconciler = reconciler
        self._has_work = has_work
        self._had_work = False
        self._worker = PeriodicWorker("reconciling streams", self._round, self.period, clock=clock)
        self.start = self._worker.start
        self.note_change = self._worker.wake
        self.close = self._worker.close

    def period(self) -> Optional[float]:
        """Seconds until the next round; None for until the next change."""
        if not self._has_work():
            return None
        silences = [
            claim.request.max_silence
            for claim in self._reconciler.claims()
            if claim.request.max_silence and not claim.state.ended
        ]
        return max(PAUSE, min([PERIOD, *(each / _ROUNDS for each in silences)]))

    def _round(self) -> None:
        """Reconcile, and once more after the last claim has ended, which releases its nodelets."""
        had_work, self._had_work = self._had_work, self._has_work()
        if self._had_work or had_work:
            self._reconciler.reconcile()


class ModelPublisher:
    """Publishes the model after changes; one message may show several."""

    def __init__(
        self,
        topic: str,
        take: Callable[[], Model],
        messages: ModelMessages,
        before: Callable[[], None] = lambda: None,
    ) -> None:
        """Advertise the topic, latched.

        Args:
            topic: its name.
            take: returns the model of this moment.
            messages: converts it.
            before: called before each message.
        """
        self._take = take
        self._messages = messages
        self._before = before
        self._shown: Optional[Tuple[int, int]] = None
        self._publisher = rospy.Publisher(topic, ModelMessage, latch=True, queue_size=1)
        self._turn = turn_lock("model on its topic")
        self._worker = PeriodicWorker("publishing the model", self.publish, pause=_MODEL_PERIOD)
        self._worker.start()

    def note_change(self) -> None:
        """Publish soon; does not wait."""
        self._worker.wake()

    def close(self) -> None:
        """Withdraw the topic."""
        self._worker.close(1.0)
        self._publisher.unregister()

    def publish(self) -> None:
        """Publish the present model, unless it was published."""
        with self._turn:
            self._before()
            model = self._take()
            revisions = (model.revision, model.library_revision)
            if revisions != self._shown:
                self._publisher.publish(self._messages.topic(model))
                self._shown = revisions
