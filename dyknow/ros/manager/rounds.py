"""A thread that works in rounds: from time to time, and soon after somebody asks for one."""

from __future__ import annotations

import logging
import threading
from typing import Callable, Optional

from dyknow.errors import DyKnowError

#: Least seconds between two rounds, whatever happens.
PAUSE = 0.05

_log = logging.getLogger("rosout.dyknow")


class Rounds:
    """One thread, one round at a time; a round that fails is logged, and the next one comes."""

    def __init__(
        self, what: str, work: Callable[[], None], period: Callable[[], Optional[float]]
    ) -> None:
        """Prepare; nothing is done yet.

        Args:
            what: what a round does, for the log.
            work: a round.
            period: most seconds until the next one; None for as long as nobody asks.
        """
        self._what = what
        self._work = work
        self._period = period
        self._condition = threading.Condition()
        self._asked = False
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=what, daemon=True)

    @property
    def running(self) -> bool:
        """Whether it was started and has not ended."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def ask(self) -> None:
        """Ask for a round soon; returns at once."""
        with self._condition:
            self._asked = True
            self._condition.notify()

    def close(self, timeout: float) -> None:
        """Begin no further round; one that is going on is waited for at most ``timeout`` s."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        if self._thread.is_alive():
            self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            period = self._period()
            with self._condition:
                self._condition.wait_for(lambda: self._closed, PAUSE)
                self._condition.wait_for(lambda: self._closed or self._asked, period)
                if self._closed:
                    return
                self._asked = False
            try:
                self._work()
            except DyKnowError as error:
                _log.warning("%s: %s", self._what, error)
            except Exception:  # the boundary of the thread: the next round may do better
                _log.exception("%s failed", self._what)
