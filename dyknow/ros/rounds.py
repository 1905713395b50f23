"""Threads that work in rounds: from time to time, and soon after somebody asks for one."""

from __future__ import annotations

import logging
import threading
from typing import Callable, Optional, TypeVar

from dyknow.errors import DyKnowError

#: Least seconds between two rounds, whatever happens.
PAUSE = 0.05
#: Seconds until what failed is tried again, asked for or not.
RETRY = 0.5

T = TypeVar("T")

_log = logging.getLogger("rosout.dyknow")


def attempt(what: str, work: Callable[[], T]) -> Optional[T]:
    """Do something at the top of a thread: what it raises is logged, and None returned."""
    try:
        return work()
    except DyKnowError as error:
        _log.warning("%s: %s", what, error)
    except Exception:  # the boundary of the thread: the next attempt may do better
        _log.exception("%s failed", what)
    return None


class Rounds:
    """One thread, one round at a time; a round that fails is logged and done again."""

    def __init__(
        self,
        what: str,
        work: Callable[[], None],
        period: Callable[[], Optional[float]],
        pause: float = PAUSE,
    ) -> None:
        """Prepare; nothing is done yet.

        Args:
            what: what a round does, for the log.
            work: a round.
            period: most seconds until the next one; None for as long as nobody asks.
            pause: least seconds until the next one.
        """
        self._what = what
        self._work = work
        self._period = period
        self._pause = pause
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
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(timeout)

    def _run(self) -> None:
        goes_on: Optional[bool] = True
        while goes_on is not False:
            goes_on = attempt(self._what, self._round)
            if goes_on is None:
                with self._condition:
                    self._condition.wait_for(lambda: self._closed, RETRY)
                    self._asked = True

    def _round(self) -> bool:
        """Wait, and do one round; False at the end."""
        period = self._period()
        with self._condition:
            self._condition.wait_for(lambda: self._closed, self._pause)
            self._condition.wait_for(lambda: self._closed or self._asked, period)
            if self._closed:
                return False
            self._asked = False
        self._work()
        return True
