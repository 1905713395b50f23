# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Pauses between attempts, which double from failure to failure.

A pause keeps what fails at once from failing all the time. What has served for a while before it
failed is not held back for long: it is away for a small part of that time at most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable

from dyknow.locks import state_lock

LONGEST = 30.0  # seconds of the longest pause
FORGIVEN_AFTER = 10.0  # seconds of good service after which earlier failures are forgiven
#: A pause is no longer than this part of the good service before it, if that took so many seconds.
SHARE, _SERVICE = 0.1, 1.0
MEMORY = 3600.0  # seconds after which a failure is forgotten in any case

_MOST_DOUBLINGS = 16


@dataclass(frozen=True)
class _Failures:
    """Failures in a row; of the last one when it was counted, its longest pause, and its cause."""

    count: int
    last: float
    longest: float
    cause: str


class Backoff:
    """Failures by name, with the pause that follows each; safe from any thread."""

    def __init__(
        self,
        clock: Callable[[], float],
        first: float,
        longest: float = LONGEST,
        forgiven_after: float = FORGIVEN_AFTER,
        tolerated: int = 1,
    ) -> None:
        """Start without failures. Pauses double, from ``first`` seconds to ``longest``.

        ``forgiven_after`` seconds of good service make up for all earlier failures. No pause
        follows so many as are ``tolerated``, since they may be chance. ``clock`` is steady.
        """
        self._clock = clock
        self._first = first
        self._longest = longest
        self._forgiven_after = forgiven_after
        self._tolerated = tolerated
        self._state_lock = state_lock("failures")
        self._failures: dict[str, _Failures] = {}

    def failed(self, name: str, after: float = 0.0, cause: str = "") -> None:
        """Count a failure, or an attempt that is one unless good service follows it.

        It ended ``after`` seconds of good service, which bound the pause. Failures with one
        ``cause``, the event behind them, count once.
        """
        now = self._clock()
        longest = min(SHARE * after, self._longest) if after >= _SERVICE else self._longest
        with self._state_lock:
            kept = {key: each for key, each in self._failures.items() if now - each.last <= MEMORY}
            known = kept.get(name)
            if known is None or not cause or known.cause != cause:
                count = known.count if known is not None else 0
                self._failures = {**kept, name: _Failures(count + 1, now, longest, cause)}

    def served(self, name: str, seconds: float) -> None:
        """Note good service that has ended; the failures before it are forgiven if it was long."""
        if seconds >= self._forgiven_after:
            self.forgive(name)

    def forgive(self, name: str) -> None:
        with self._state_lock:
            self._failures.pop(name, None)

    def remaining(self, name: str) -> float:
        """Seconds until the pause of a name is over; 0 if it is."""
        with self._state_lock:
            return self._remaining(name)

    def allows(self, name: str) -> bool:
        return self.remaining(name) <= 0.0

    @property
    def paused(self) -> frozenset[str]:
        """Names whose pause is not over."""
        with self._state_lock:
            return frozenset(name for name in self._failures if self._remaining(name) > 0.0)

    @property
    def soonest(self) -> float:
        """Seconds until the next pause is over; infinite if there is none."""
        with self._state_lock:
            left = map(self._remaining, self._failures)
            return min((each for each in left if each > 0.0), default=math.inf)

    def _remaining(self, name: str) -> float:
        failures = self._failures.get(name)
        if failures is None or failures.count <= self._tolerated:
            return 0.0
        doublings = min(failures.count - self._tolerated - 1, _MOST_DOUBLINGS)
        pause = min(failures.longest, self._first * 2.0**doublings)
        return max(0.0, failures.last + pause - self._clock())
