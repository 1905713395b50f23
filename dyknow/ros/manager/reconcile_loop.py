"""Keeps claimed streams alive; sleeps while nothing is claimed."""

from __future__ import annotations

from typing import Callable, Optional

from dyknow.manager.claims.reconciler import StreamReconciler
from dyknow.periodic import PAUSE, PeriodicWorker

#: Seconds between two rounds as long as there is something to be looked after.
PERIOD = 0.5
#: Rounds in the time that a stream may be silent, where a claim says so.
_ROUNDS = 4


class ReconcileLoop:
    """Lets the reconciler look at its claims, soon after changes and from time to time."""

    def __init__(self, reconciler: StreamReconciler, has_work: Callable[[], bool]) -> None:
        """Prepare; nothing is done yet.

        Args:
            reconciler: who looks.
            has_work: whether there is anything to be looked after; if not, nothing is done until
                the next change.
        """
        self._reconciler = reconciler
        self._has_work = has_work
        self._had_work = False
        self._worker = PeriodicWorker("looking after streams", self._round, self.period)
        self.start = self._worker.start
        self.note_change = self._worker.wake
        self.close = self._worker.close

    def period(self) -> Optional[float]:
        """Most seconds until the next round; None: until the next change."""
        if not self._has_work():
            return None
        silences = [
            claim.request.max_silence
            for claim in self._reconciler.claims()
            if claim.request.max_silence and not claim.state.ended
        ]
        return max(PAUSE, min([PERIOD, *(each / _ROUNDS for each in silences)]))

    def _round(self) -> None:
        """Reconcile, and once more when the last claim has ended: nodelets are released then."""
        had_work, self._had_work = self._had_work, self._has_work()
        if self._had_work or had_work:
            self._reconciler.reconcile()
