# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Finds lost and doubled messages by their numbers, at a port that is switched.

Two ends are watched. At an in-port that is switched between two topics, one of which carries the
even and the other the odd numbers, the numbers of one topic must follow each other without a gap
until the switch, and those of the new topic begin where those of the old end. At two in-ports
between which another nodelet's out-port is switched, every number must come exactly once.
"""

from __future__ import annotations

import time
from typing import Callable, List

Clock = Callable[[], int]


class Sequence:
    """What arrives at one end; ``collect`` tells what was wrong, and when the source changed."""

    def __init__(self, clock: Clock = time.time_ns) -> None:
        self._clock = clock
        self._changes: List[float] = []
        self.lost = 0
        self.doubled = 0

    def changed(self) -> None:
        """Note that this is the first message of the new topic."""
        self._changes.append(self._clock() / 1e9)

    def collect(self) -> List[float]:
        """Return lost, doubled and the times (s) of the first messages of new topics."""
        return [self.lost, self.doubled, *self._changes]


class SwitchedIn(Sequence):
    """An in-port that is switched between the topic of even and that of odd numbers."""

    def __init__(self, clock: Clock = time.time_ns) -> None:
        super().__init__(clock)
        self._last = -1
        self._latest = [-2, -1]

    def receive(self, number: int) -> None:
        """Take the next number."""
        if number <= self._latest[number % 2]:
            self.doubled += 1
            return
        before, self._last = self._last, number
        self._latest[number % 2] = number
        if before < 0:
            return
        if number % 2 != before % 2:
            self.changed()
            # Where the old topic ends at n the new one may begin at n + 1, or at n + 3 if n + 1
            # came before the switch.
            self.lost += max(0, (number - before - 2) // 2)
        else:
            self.lost += (number - before) // 2 - 1


class SwitchedOut(Sequence):
    """Two in-ports, to one of which an out-port is connected."""

    def __init__(self, clock: Clock = time.time_ns) -> None:
        super().__init__(clock)
        self._last = -1
        self._side = ""

    def receive(self, side: str, number: int) -> None:
        """Take the next number, at the in-port ``side``."""
        if number <= self._last:
            self.doubled += 1
            return
        before, self._last = self._last, number
        if before >= 0:
            self.lost += number - before - 1
        if self._side and side != self._side:
            self.changed()
        self._side = side
