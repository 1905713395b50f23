# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A clock that stands still while this process is stopped.

A process that was stopped has heard nothing meanwhile, which says nothing of its peers. Whoever
waits for their answers by this clock still gives them their time when the process goes on.
"""

from __future__ import annotations

import time
from typing import Callable

from dyknow.locks import state_lock
from dyknow.periodic import PeriodicWorker

#: Seconds between two ticks.
TICK = 0.1
#: Seconds that count at most between two ticks: what is beyond was a pause.
LONGEST = 0.3


class RunningClock:
    """Seconds for which this process has run; safe from any thread."""

    def __init__(self, steady: Callable[[], float] = time.monotonic) -> None:
        """Begin at 0; it stands still between readings that are far apart, until ``start``.

        Args:
            steady: steady time, in seconds.
        """
        self._steady = steady
        self._state_lock = state_lock("running clock")
        self._last = steady()
        self._run = 0.0

    def __call__(self) -> float:
        """Return the time."""
        with self._state_lock:
            now = self._steady()
            self._run += min(now - self._last, LONGEST)
            self._last = now
            return self._run


def started() -> RunningClock:
    """Make a clock that a thread keeps going for as long as the process runs."""
    clock = RunningClock()
    PeriodicWorker("the clock of this process", clock, TICK).start()
    return clock
