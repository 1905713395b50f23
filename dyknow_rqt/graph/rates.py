# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Rates of ports, from the counts that the manager publishes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict, Iterable, List, Mapping, Optional, Set, Tuple

from dyknow.model.graph import PortRef
from dyknow.model.statistics import NodeletCount

#: Seconds over which rates are computed at most, and drops are counted at least.
_STRETCH = 4.0
#: Messages that are overdue in a stream that is silent.
_OVERDUE = 1.4
#: Seconds until a port whose rate is not known counts as silent.
_UNKNOWN = 1.5
#: Seconds between two counts of a nodelet that was stopped, or did not answer.
_PAUSE = 2.5


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


@dataclass
class _Track:
    """The counts of a port since it was connected, or began to send again.

    Attributes:
        moves: times and numbers of messages of the last counts that found new ones.
        drops: times and numbers of drops where two stretches began.
        is_overdue: no message came when the next was due.
    """

    moves: List[Tuple[float, int]] = field(default_factory=list)
    drops: List[Tuple[float, int]] = field(default_factory=list)
    is_overdue: bool = False

    def take(self, time: float, messages: int, dropped: int) -> Optional[PortRate]:
        """Take a count; returns the traffic, None while it is not known."""
        self.drops = self.drops or [(time, dropped)]
        if time - self.drops[-1][0] >= _STRETCH:
            self.drops = [self.drops[-1], (time, dropped)]
        since, before = self.drops[0]
        drop_rate = (dropped - before) / (time - since) if time > since else 0.0
        rate = self._rate(time, messages)
        return None if rate is None else PortRate(rate, drop_rate, messages, dropped)

    def _rate(self, time: float, messages: int) -> Optional[float]:
        moves = self.moves
        if not moves or messages != moves[-1][1]:
            is_resumed = moves and time - moves[-1][0] > _STRETCH and messages > moves[-1][1] + 1
            if self.is_overdue or is_resumed:
                moves.clear()  # no rate is averaged over a pause
            self.is_overdue = False
            moves.append((time, messages))
        while len(moves) > 2 and time - moves[0][0] > _STRETCH:
            del moves[0]
        (begin, first), (end, last) = moves[0], moves[-1]
        if begin == end:
            return 0.0 if time - end > _UNKNOWN else None
        rate = (last - first) / (end - begin)
        self.is_overdue = (time - end) * rate > _OVERDUE
        return 0.0 if self.is_overdue else rate


class Meter:
    """Computes rates from counts.

    They begin anew when a nodelet was connected elsewhere, loaded again, or stopped for a while:
    what was sent or dropped before says nothing about its present connections.
    """

    def __init__(self) -> None:
        self._last: Dict[str, Tuple[float, NodeletCount]] = {}
        self._topics: Mapping[PortRef, str] = {}
        self._tracks: Dict[PortRef, _Track] = {}
        #: The traffic of all ports where it is known.
        self.traffic: Dict[PortRef, PortRate] = {}

    def take(self, counts: Iterable[NodeletCount], now: float) -> None:
        """Take the counts that came ``now``, in seconds of a steady clock."""
        for each in counts:
            _, before = self._last.get(each.nodelet, (now, each))
            self._last[each.nodelet] = now, each
            if each.reconfigurations != before.reconfigurations or not (
                0.0 <= each.uptime - before.uptime < _PAUSE
            ):
                self._forget({each.nodelet})
            for port, (messages, dropped) in each.ports.items():
                ref = PortRef(each.nodelet, port)
                if ref not in self._topics:
                    continue
                track = self._tracks.setdefault(ref, _Track())
                traffic = track.take(each.uptime, messages, dropped)
                if traffic is None:
                    self.traffic.pop(ref, None)
                else:
                    self.traffic[ref] = traffic
        missed = {name for name, (came, _) in self._last.items() if now - came > _PAUSE}
        for name in missed:
            del self._last[name]
        self._forget(missed)

    def keep(self, topics: Mapping[PortRef, str]) -> None:
        """Measure these ports from now on, and anew if their topics are others than before."""
        before, self._topics = self._topics, topics
        self._drop(ref for ref in before if before[ref] != topics.get(ref))

    def _forget(self, nodelets: Set[str]) -> None:
        if nodelets:
            self._drop(ref for ref in self._topics if ref.nodelet in nodelets)

    def _drop(self, refs: Iterable[PortRef]) -> None:
        for ref in refs:
            self._tracks.pop(ref, None)
            self.traffic.pop(ref, None)


def _number(value: float) -> str:
    if value == 0:
        return "0"
    if value < 0.995:
        return f"{value:.2f}"
    return f"{value:.1f}" if value < 99.95 else f"{value:.0f}"
