"""Keeps the manager's picture true: two looks a second, and one when something happens."""

from __future__ import annotations

import logging
import threading
from typing import Callable, Set

from dyknow.errors import DyKnowError
from dyknow.manager.manager import Manager

#: Seconds between two looks when nothing happens.
PERIOD = 0.5
#: Least seconds between two looks, whatever happens.
PAUSE = 0.05

_log = logging.getLogger("rosout.dyknow")


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
        self._condition = threading.Condition()
        self._changed: Set[str] = set()
        self._hurry = False
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def hear(self, name: str) -> None:
        """Look closely at a nodelet, soon."""
        with self._condition:
            self._changed.add(name)
            self._condition.notify()

    def hurry(self) -> None:
        """Look soon."""
        with self._condition:
            self._hurry = True
            self._condition.notify()

    def close(self, timeout: float) -> None:
        """Look no more; a look that is going on is waited for at most ``timeout`` s."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        if self._thread.is_alive():
            self._thread.join(timeout)

    def _run(self) -> None:
        postponed: Set[str] = set()
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._closed, PAUSE)
                self._condition.wait_for(
                    lambda: self._closed or self._hurry or self._changed,
                    PAUSE if postponed else PERIOD,
                )
                if self._closed:
                    return
                changed, self._changed, self._hurry = self._changed | postponed, set(), False
            # A nodelet that somebody works on is skipped by this look, so the next one has to
            # look at it closely.
            postponed = {name for name in changed if self._manager.graph.is_busy(name)}
            try:
                self._manager.look(changed)
            except DyKnowError as error:
                _log.warning("%s", error)
            except Exception:  # the boundary of the thread: the next look may do better
                _log.exception("looking at the nodelet managers failed")
            self._after()
