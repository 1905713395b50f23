# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Rates of ports, from the counts of two readings of their statistics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Dict, Iterable, Tuple

from dyknow.model.graph import PortRef

if TYPE_CHECKING:
    from dyknow.model.statistics import NodeletStatistics


@dataclass(frozen=True)
class PortRate:
    """The traffic of a port: messages a second now, and counts since its nodelet was loaded."""

    rate: float
    drop_rate: float
    messages: int
    dropped: int

    @property
    def text(self) -> str:
        """The text of an arrow's label."""
        if self.drop_rate > 0:
            return f"{_number(self.rate)} Hz\n−{_number(self.drop_rate)}/s"
        return f"{_number(self.rate)} Hz"


@dataclass(frozen=True)
class _Count:
    time: float
    uptime: float
    messages: int
    dropped: int


class Meter:
    """Computes rates from differences to the last counts of each port."""

    def __init__(self) -> None:
        self._last: Dict[PortRef, _Count] = {}
        self._traffic: Dict[PortRef, PortRate] = {}

    def note(self, nodelet: str, statistics: NodeletStatistics, now: float) -> None:
        """Take the statistics of a nodelet.

        Args:
            nodelet: its name.
            statistics: what it answered.
            now: when, in seconds by a steady clock.
        """
        for port in statistics.ports:
            ref = PortRef(nodelet, port.port)
            if port.messages is None or port.dropped is None or port.rate is None:
                self._last.pop(ref, None)  # messages of this port are not counted
                self._traffic.pop(ref, None)
                continue
            count = _Count(now, statistics.uptime, port.messages, port.dropped)
            last = self._last.get(ref)
            rate, drops = port.rate, 0.0
            # Counts start at zero when a nodelet is loaded again.
            if last is not None and count.uptime >= last.uptime and now > last.time:
                rate = (count.messages - last.messages) / (now - last.time)
                drops = (count.dropped - last.dropped) / (now - last.time)
            self._last[ref] = count
            self._traffic[ref] = PortRate(
                max(rate, 0.0), max(drops, 0.0), port.messages, port.dropped
            )

    def keep(self, nodelets: Iterable[str]) -> None:
        """Forget all other nodelets."""
        names = set(nodelets)
        for ref in [ref for ref in self._last if ref.nodelet not in names]:
            del self._last[ref], self._traffic[ref]

    @property
    def traffic(self) -> Dict[PortRef, PortRate]:
        """The rates of all ports that were measured."""
        return dict(self._traffic)


def in_turns(names: Iterable[str], start: int, count: int) -> Tuple[Tuple[str, ...], int]:
    """Return the next names in a round.

    Returns:
        The names, and where to begin next time.
    """
    ordered = sorted(names)
    if not ordered:
        return (), 0
    start %= len(ordered)
    chosen = (ordered + ordered)[start : start + min(count, len(ordered))]
    return tuple(chosen), (start + len(chosen)) % len(ordered)


def _number(value: float) -> str:
    return f"{value:.1f}" if value < 99.95 else f"{value:.0f}"
