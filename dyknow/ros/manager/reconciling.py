"""The thread that keeps claimed streams alive: it sleeps while nothing is claimed."""

from __future__ import annotations

import logging
import threading
from typing import Callable

from dyknow.errors import DyKnowError
from dyknow.manager.claims.keeper import Keeper

#: Seconds between two rounds as long as there is something to be looked after.
PERIOD = 0.5
#: Rounds in the time that a stream may be silent, where a claim says so.
_ROUNDS = 4
#: Least seconds between two rounds, whatever happens.
PAUSE = 0.05

_log = logging.getLogger("rosout.dyknow")


class Reconciling:
    """Lets the keeper look at its claims, soon after changes and from time to time."""

    def __init__(self, keeper: Keeper, has_work: Callable[[], bool]) -> None:
        """Prepare; nothing is done yet.

        Args:
            keeper: who looks.
            has_work: whether there is anything to be looked after; if not, the thread sleeps until
                the next change.
        """
        self._keeper = keeper
        self._has_work = has_work
        self._condition = threading.Condition()
        self._changed = False
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="claims", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def note_change(self) -> None:
        """Say that something changed; returns at once."""
        with self._condition:
            self._changed = True
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
                self._condition.wait_for(lambda: self._closed or self._changed, period)
                if self._closed:
                    return
                self._changed = False
            if self._has_work():
                self._round()

    def _period(self) -> float | None:
        if not self._has_work():
            return None
        silences = [
            claim.request.max_silence
            for claim in self._keeper.claims()
            if claim.request.max_silence and not claim.state.ended
        ]
        return max(PAUSE, min([PERIOD, *(each / _ROUNDS for each in silences)]))

    def _round(self) -> None:
        try:
            self._keeper.reconcile()
        except DyKnowError as error:
            _log.warning("looking after streams: %s", error)
        except Exception:  # the boundary of the thread: the next round may do better
            _log.exception("looking after streams failed")
