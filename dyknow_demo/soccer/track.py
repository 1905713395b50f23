# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The ball's positions as they arrive, compared with the simulated truth."""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from typing import Callable, List, Sequence

from dyknow_demo.soccer.rigid import Array

#: Metres: several times the measured error; a stream of wrong positions must not pass.
LARGE_ERROR = 0.3


@dataclass(frozen=True)
class Stretch:
    """The positions that arrived in a stretch of time.

    Attributes:
        count: number of positions.
        rate: positions per second.
        median: median error, m; nan without positions.
        worst: greatest error, m; nan without positions.
        pause: longest time (s) without a position, the time at either end included.
    """

    count: int
    rate: float
    median: float
    worst: float
    pause: float


class Track:
    """Arrivals and errors, in order of arrival; arrival times are of one steady clock."""

    def __init__(self, begin: float, truth: Callable[[float], Array]) -> None:
        """Make an empty track.

        Args:
            begin: time from which on positions are expected, s.
            truth: centre of the ball (3,), m, by time of the stamps, s.
        """
        self._begin = begin
        self._truth = truth
        self._arrivals: list[float] = []
        self._errors: list[float] = []

    def note(self, arrival: float, stamp: float, x: float, y: float) -> None:
        """Add a position (m) on the field."""
        truth = self._truth(stamp)
        self._errors.append(float(((x - truth[0]) ** 2 + (y - truth[1]) ** 2) ** 0.5))
        self._arrivals.append(arrival)

    def stretch(self, begin: float, end: float) -> Stretch:
        """Summarise the arrivals between two times."""
        count = len(self._arrivals)
        chosen = [
            (arrival, error)
            for arrival, error in zip(self._arrivals[:count], self._errors)
            if begin <= arrival <= end
        ]
        before = [arrival for arrival in self._arrivals[:count] if arrival < begin]
        start = before[-1] if before else self._begin
        times = [start, *(arrival for arrival, _ in chosen), end]
        errors = [error for _, error in chosen]
        return Stretch(
            len(errors),
            len(errors) / (end - begin) if end > begin else 0.0,
            statistics.median(errors) if errors else float("nan"),
            max(errors, default=float("nan")),
            _longest(times),
        )

    def whole(self, end: float) -> Stretch:
        """Summarise all arrivals."""
        return self.stretch(self._begin, end)


def shortcomings(stretch: Stretch, max_silence: float) -> List[str]:
    """List how a stretch breaks the promise of a claim with that ``max_silence`` (s)."""
    found = []
    if stretch.pause > max_silence:
        found.append(f"the position was lost for {stretch.pause:.2f} s, not {max_silence:g} s")
    if not stretch.median < LARGE_ERROR:
        found.append(f"the positions are wrong by {stretch.median:.2f} m")
    return found


def _longest(times: Sequence[float]) -> float:
    return max(later - earlier for earlier, later in zip(times, times[1:]))
