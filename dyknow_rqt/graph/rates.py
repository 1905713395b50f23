# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Rates of ports, from readings of their statistics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Dict, Iterable, Tuple

from dyknow.model.graph import PortRef

if TYPE_CHECKING:
    from dyknow.model.statistics import NodeletStatistics

#: Seconds over which drops are counted at least.
_STRETCH = 4.0
#: Messages that are overdue, and seconds without one, before a stream is called silent.
_OVERDUE = 4.0
_SILENCE = 2.0


@dataclass(frozen=True)
class PortRate:
    """The traffic of a port: messages a second now, and counts since its nodelet was loaded."""

    rate: float
    drop_rate: float
    messages: int
    dropped: int

    @property
    def text(self) -> str:
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
    """Keeps the rates that the proxies report, and computes those of drops, which they only count.

    Drops are counted over the last one to two stretches of ``_STRETCH`` seconds. What a proxy
    tells falls slowly once no messages come; here it is 0 as soon as several are overdue.
    """

    def __init__(self) -> None:
        self._last: Dict[PortRef, Tuple[_Count, _Count]] = {}
        #: The first readings of the present numbers of messages.
        self._moved: Dict[PortRef, _Count] = {}
        self._traffic: Dict[PortRef, PortRate] = {}

    def note(self, nodelet: str, statistics: NodeletStatistics, now: float) -> None:
        """Take the statistics of a nodelet at a time in seconds of a steady clock."""
        for port in statistics.ports:
            ref = PortRef(nodelet, port.port)
            if port.messages is None or port.dropped is None or port.rate is None:
                self._forget(ref)  # messages of this port are not counted
                continue
            count = _Count(now, statistics.uptime, port.messages, port.dropped)
            before, begin = self._last.get(ref, (count, count))
            if count.uptime < begin.uptime:  # loaded again: counts begin at zero
                before = begin = count
            elif now - begin.time >= _STRETCH:
                before, begin = begin, count
            self._last[ref] = before, begin
            seconds = now - before.time
            drops = (count.dropped - before.dropped) / seconds if seconds > 0 else 0.0
            moved = self._moved.get(ref, count)
            if moved.messages != count.messages:
                moved = count
            self._moved[ref] = moved
            is_silent = (now - moved.time) * port.rate > _OVERDUE and now - moved.time > _SILENCE
            rate = 0.0 if is_silent else port.rate
            self._traffic[ref] = PortRate(rate, drops, port.messages, port.dropped)

    def miss(self, nodelet: str) -> None:
        """Note that a nodelet did not answer: its rates are unknown."""
        for ref in [ref for ref in self._traffic if ref.nodelet == nodelet]:
            self._forget(ref)

    def keep(self, nodelets: Iterable[str]) -> None:
        names = set(nodelets)
        for ref in [ref for ref in self._traffic if ref.nodelet not in names]:
            self._forget(ref)

    @property
    def traffic(self) -> Dict[PortRef, PortRate]:
        """The rates of all ports that were measured."""
        return dict(self._traffic)

    def _forget(self, ref: PortRef) -> None:
        self._last.pop(ref, None)
        self._moved.pop(ref, None)
        self._traffic.pop(ref, None)


def in_turns(names: Iterable[str], start: int, count: int) -> Tuple[Tuple[str, ...], int]:
    """Return the next names in a round, and where to begin next time."""
    ordered = sorted(names)
    if not ordered:
        return (), 0
    start %= len(ordered)
    chosen = (ordered + ordered)[start : start + min(count, len(ordered))]
    return tuple(chosen), (start + len(chosen)) % len(ordered)


def _number(value: float) -> str:
    if value == 0:
        return "0"
    if value < 0.995:
        return f"{value:.2f}"
    return f"{value:.1f}" if value < 99.95 else f"{value:.0f}"
