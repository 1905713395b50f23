# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How much effort the improvement of a plan may take."""

from __future__ import annotations

from typing import Callable

#: Steps that are taken in a second, on a slow machine.
STEPS = 10_000_000


class Budget:
    """Counts steps, so that equal problems have equal plans; the clock is the last resort."""

    def __init__(self, seconds: float, clock: Callable[[], float]) -> None:
        """Start.

        Args:
            seconds: what the improvement may take.
            clock: steady time, in seconds.
        """
        self._clock = clock
        self._deadline = clock() + seconds
        self.steps = int(seconds * STEPS)
        #: Whether the clock ended it.
        self.is_cut_short = False

    def spend(self, steps: int) -> bool:
        """Take steps; tell whether they were left."""
        self.steps -= steps
        if self.steps < 0:
            return False
        if self._clock() >= self._deadline:
            self.is_cut_short = True
            self.steps = -1
            return False
        return True
