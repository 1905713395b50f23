"""Keeps the manager's picture true: two looks a second, and one when something happens."""

from __future__ import annotations

import collections
from typing import Callable, Deque, Set

from dyknow.manager.manager import Manager
from dyknow.periodic import PAUSE, PeriodicWorker

#: Seconds between two looks when nothing happens.
PERIOD = 0.5


class Watch:
    """One thread that looks."""

    def __init__(self, manager: Manager, after: Callable[[], None]) -> None:
        """Prepare; nothing is looked at yet.

        Args:
            manager: who looks.
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
        """Look closely at a nodelet, soon."""
        self._changed.append(name)
        self._worker.wake()

    def _period(self) -> float:
        return PAUSE if self._postponed else PERIOD

    def _look(self) -> None:
        changed = self._postponed
        while self._changed:
            changed.add(self._changed.popleft())
        # A nodelet that somebody works on is skipped by this look, so the next one has to look at
        # it closely.
        self._postponed = {name for name in changed if self._manager.graph.is_busy(name)}
        try:
            self._manager.look(changed)
        finally:
            self._after()
