# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Statistics of measured times."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Sequence, Tuple

#: Columns of what ``Summary.arrivals`` returns for latencies in us.
ARRIVALS = ("messages", "lost", "mean_us", "median_us", "p99_us", "max_us")


@dataclass(frozen=True)
class Summary:
    """Times of some events, in the unit they were measured in; zero when there are none.

    Attributes:
        count: number of values.
        mean: arithmetic mean.
        median: the middle value.
        p99: the smallest value that at least 99 % do not exceed.
        max: the largest value.
    """

    count: int = 0
    mean: float = 0.0
    median: float = 0.0
    p99: float = 0.0
    max: float = 0.0

    @classmethod
    def of(cls, values: Sequence[float]) -> Summary:
        """Sum up values in any order."""
        if not values:
            return cls()
        ordered = sorted(values)
        return cls(
            count=len(ordered),
            mean=math.fsum(ordered) / len(ordered),
            median=median(ordered),
            p99=quantile(ordered, 0.99),
            max=ordered[-1],
        )

    def arrivals(self, sent: int) -> Tuple[float, ...]:
        """Cells under ``ARRIVALS``, where these are the latencies of what was sent."""
        lost = sent - self.count
        return (self.count, lost, self.mean, self.median, self.p99, self.max)


def median(values: Sequence[float]) -> float:
    """Return the middle value, or the mean of the two in the middle."""
    if not values:
        raise ValueError("no values: they have no median")
    ordered = sorted(values)
    middle = len(ordered) // 2
    if len(ordered) % 2:
        return ordered[middle]
    return (ordered[middle - 1] + ordered[middle]) / 2


def quantile(ordered: Sequence[float], share: float) -> float:
    """Return the smallest of ascending values that at least ``share`` of them do not exceed."""
    rank = math.ceil(share * len(ordered))
    return ordered[min(len(ordered), max(1, rank)) - 1]


def median_interval(values: Sequence[float]) -> Tuple[float, float]:
    """Bounds between which the true median lies with a probability of at least 95 %.

    They are two of the values themselves, found by the binomial distribution of how many values
    fall below the median; nothing is assumed of how the values are distributed. With less than
    six values there are no such bounds, and the extremes are returned.
    """
    if not values:
        raise ValueError("no values: they have no median")
    ordered = sorted(values)
    count = len(ordered)
    rank, at_most, log_ways = 0, 0.0, 0.0
    # at_most: probability that at most k of the values lie below the median.
    for k in range(count // 2):
        at_most += math.exp(log_ways - count * math.log(2))
        if at_most > 0.025:
            break
        rank = k
        log_ways += math.log((count - k) / (k + 1))
    return ordered[rank], ordered[count - 1 - rank]
