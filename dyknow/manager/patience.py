"""How long to wait before what died, or did not come up, is started again.

Two deaths in a row may be chance: both are mended at once. Then the pauses grow, so that what dies
again and again leaves the machine to others; a long life in between makes it start over.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Callable, Dict, Optional

#: Seconds before the third attempt in a row, doubling from there.
FIRST_PAUSE = 0.25
LONGEST_PAUSE = 30.0
#: Seconds of life after which the past is forgiven.
LONG_LIFE = 10.0

_AT_ONCE = 2


def pause(attempts: int) -> float:
    """Seconds to wait before the next attempt after so many in a row."""
    if attempts < _AT_ONCE:
        return 0.0
    return float(min(LONGEST_PAUSE, FIRST_PAUSE * 2 ** min(attempts - _AT_ONCE, 16)))


@dataclass
class _Past:
    """Attempts in a row, when the last began, and since when it is up; None if it is not."""

    attempts: int = 0
    last: float = 0.0
    up: Optional[float] = None


class Patience:
    """When to try next, by name; attempts count until one of them leads to a long life."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """Know nothing of anybody; ``clock`` gives seconds, steady."""
        self._clock = clock
        self._lock = threading.Lock()
        self._pasts: Dict[str, _Past] = {}

    def allows(self, name: str) -> bool:
        """Whether an attempt may be made now."""
        with self._lock:
            past = self._pasts.get(name)
            return past is None or self._clock() - past.last >= pause(past.attempts)

    def attempt(self, name: str) -> None:
        """Count an attempt that begins now."""
        with self._lock:
            past = self._pasts.get(name, _Past())
            self._pasts[name] = _Past(past.attempts + 1, self._clock())

    def came_up(self, name: str) -> None:
        """Note that a life begins now."""
        with self._lock:
            past = self._pasts.get(name)
            if past is not None and past.up is None:
                past.up = self._clock()

    def died(self, name: str) -> None:
        """Note that it was found dead; the past of one that lived long is forgiven."""
        with self._lock:
            past = self._pasts.get(name, _Past())
            if past.up is not None and self._clock() - past.up >= LONG_LIFE:
                del self._pasts[name]
            past.up = None
