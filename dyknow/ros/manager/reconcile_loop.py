# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The thread that reconciles claims; it sleeps while there are none."""

from __future__ import annotations

from typing import Callable, Optional

from dyknow.manager.claims.reconciler import StreamReconciler
from dyknow.periodic import PAUSE, PeriodicWorker

#: Seconds between two rounds while there are claims.
PERIOD = 0.5
#: Rounds in the ``max_silence`` of a claim.
_ROUNDS = 4


class ReconcileLoop:
    """Calls the reconciler periodically, and soon after changes."""

    def __init__(self, reconciler: StreamReconciler, has_work: Callable[[], bool]) -> None:
        """Prepare; ``start`` starts the thread.

        Args:
            reconciler: what is called.
            has_work: whether there are claims, or nodelets of claims; if not, the next round comes
                after the next change.
        """
        self._reconciler = reconciler
        self._has_work = has_work
        self._had_work = False
        self._worker = PeriodicWorker("reconciling streams", self._round, self.period)
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
