# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Keeps the manager's picture true: a look every half second, and at once after an event."""

from __future__ import annotations

import collections
from typing import Callable, Deque, Set

from dyknow.manager.manager import Manager
from dyknow.periodic import PAUSE, PeriodicWorker

#: Seconds between two looks when nothing happens.
PERIOD = 0.5


class Watch:
    """Lets the manager look at its nodelet managers, on a thread of its own."""

    def __init__(self, manager: Manager, after: Callable[[], None]) -> None:
        """Prepare; ``start`` starts the thread.

        Args:
            manager: looks.
            after: called after each look.
        """
        self._manager = manager
        self._after = after
        self._changed: Deque[str] = collections.deque()
        self._postponed: Set[str] = set()
        self._worker = PeriodicWorker("looking at the nodelet managers", self._look, self._period)
        self.start = self._worker.start
        self.refresh_now = self._worker.wake
        self.close = self._worker.close

    def refresh(self, name: str) -> None:
        """Ask for a look that asks a nodelet for its ports; does not wait."""
        self._changed.append(name)
        self._worker.wake()

    def _period(self) -> float:
        return PAUSE if self._postponed else PERIOD

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
