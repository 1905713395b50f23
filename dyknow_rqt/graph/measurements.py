# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What is measured: rates of ports, loads of nodelets, and verdicts of formulas.

Rates and loads are computed from the counts that the manager publishes.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Iterable, Iterator, Mapping, Sequence

from dyknow.formulas import Truth, Verdict
from dyknow.model.graph import NodeletStatus, PortRef, PortState, State
from dyknow.model.statistics import NodeletCount, NodeletLoad, PortCount
from dyknow.model.streams import StreamStatus
from dyknow.model.transformation import IN, VERDICT

#: Seconds over which rates are computed at most, and drops are counted at least.
_STRETCH = 4.0
#: Messages that are overdue in a stream that is silent.
_OVERDUE = 1.4
#: Seconds until a port whose rate is not known counts as silent.
_UNKNOWN = 1.5
#: Seconds between two counts of a nodelet that was stopped, or did not answer.
_PAUSE = 2.5
#: Counts over which a load is computed: a callback that takes long is not in each of them.
_LOADS = 5
#: Seconds from which on messages are old, and from which on their stamps are of another clock.
_OLD, _OTHER_CLOCK = 1.0, 3600.0
#: Share of a core from which on a nodelet is busy.
_BUSY = 0.5


@dataclass(frozen=True)
class PortRate:
    """The traffic of a port: messages and drops, a second now, and since its nodelet was loaded.

    The bandwidth is in bytes a second; the age is the time (s) from the stamp of a message to its
    publication. Both are None if not known.
    """

    rate: float
    drop_rate: float
    messages: int
    dropped: int
    bandwidth: float | None = None
    age: float | None = None

    @property
    def is_old(self) -> bool:
        """Whether messages are old when they are published, by stamps of the same clock."""
        return self.age is not None and _OLD <= self.age < _OTHER_CLOCK

    @property
    def text(self) -> str:
        lines = [f"{_number(self.rate)} Hz"]
        if self.drop_rate > 0:
            lines.append(f"−{_number(self.drop_rate)}/s")
        if self.is_old and self.age is not None:
            lines.append(f"{_number(self.age)} s old")
        return "\n".join(lines)


@dataclass(frozen=True)
class Strain:
    """What makes a nodelet stand out: its load, and the text of an error that came lately.

    The load is a share of one core, of 1 at most; without processor time that of its callbacks.
    """

    load: float = 0.0
    error: str = ""

    @property
    def text(self) -> str:
        load = f"{100 * self.busy:.0f} % of a core" if self.busy else ""
        error = f"an error less than half a minute ago: {self.error}" if self.error else ""
        return "\n".join(filter(None, (load, error)))

    @property
    def busy(self) -> float:
        """The load in steps of 5 %; 0 for one that does not stand out."""
        return round(self.load * 20) / 20 if self.load >= _BUSY else 0.0


@dataclass
class _Track:
    """The counts of a port since it was connected, or began to send again.

    Attributes:
        moves: times and numbers of messages of the last counts that found new ones.
        drops: times and numbers of drops where two stretches began.
        begin: time of the first count, which is not that of a message.
        is_overdue: no message came when the next was due.
    """

    moves: list[tuple[float, int]] = field(default_factory=list)
    drops: list[tuple[float, int]] = field(default_factory=list)
    begin: float = -1.0
    is_overdue: bool = False

    def take(self, time: float, count: PortCount) -> PortRate | None:
        """Take a count; returns the traffic, None while it is not known."""
        messages, dropped = count.messages, count.dropped
        self.drops = self.drops or [(time, dropped)]
        if time - self.drops[-1][0] >= _STRETCH:
            self.drops = [self.drops[-1], (time, dropped)]
        since, before = self.drops[0]
        drop_rate = (dropped - before) / (time - since) if time > since else 0.0
        rate = self._rate(time, messages)
        if rate is None:
            return None
        bandwidth = rate * count.size if count.size else None
        return PortRate(rate, drop_rate, messages, dropped, bandwidth, count.age if rate else None)

    def _rate(self, time: float, messages: int) -> float | None:
        moves = self.moves
        if self.begin < 0.0:
            self.begin = time
        if not moves or messages != moves[-1][1]:
            pause = _STRETCH if len(moves) > 1 else _UNKNOWN  # it may not have sent before
            is_resumed = moves and time - moves[-1][0] > pause and messages > moves[-1][1] + 1
            if self.is_overdue or is_resumed:
                moves.clear()  # no rate is averaged over a pause
            self.is_overdue = False
            moves.append((time, messages))
        if len(moves) > 2 and moves[0][0] == self.begin and moves[1][0] - self.begin > _UNKNOWN:
            del moves[0]
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

    They start again when a nodelet was connected elsewhere, loaded again, or stopped for a while:
    counts from before say nothing about its present connections.
    """

    def __init__(self) -> None:
        self._last: dict[str, tuple[float, deque[NodeletCount]]] = {}
        self._topics: Mapping[PortRef, str] = {}
        self._tracks: dict[PortRef, _Track] = {}
        #: The traffic of all ports where it is known.
        self.traffic: dict[PortRef, PortRate] = {}
        #: That of nodelets, by name, where it is known.
        self.strains: dict[str, Strain] = {}

    def take(self, counts: Iterable[NodeletCount], now: float) -> None:
        """Take the counts that came ``now``, in seconds of a steady clock."""
        for each in counts:
            _, counted = self._last.get(each.nodelet, (now, deque([each], _LOADS)))
            before = counted[-1]
            is_paused = not 0.0 <= each.uptime - before.uptime < _PAUSE or _is_less(each, before)
            if is_paused or each.reconfigurations != before.reconfigurations:
                self._forget({each.nodelet})
            if is_paused:
                counted.clear()
            counted.append(each)
            self._last[each.nodelet] = now, counted
            self._strain(counted)
            for port, count in each.ports.items():
                ref = PortRef(each.nodelet, port)
                if ref not in self._topics:
                    continue
                track = self._tracks.setdefault(ref, _Track())
                traffic = track.take(each.uptime, count)
                if traffic is None:
                    self.traffic.pop(ref, None)
                else:
                    self.traffic[ref] = traffic
        missed = {name for name, (came, _) in self._last.items() if now - came > _PAUSE}
        for name in missed:
            del self._last[name]
            self.strains.pop(name, None)
        self._forget(missed)

    def keep(self, topics: Mapping[PortRef, str]) -> None:
        """Measure these ports from now on, and again from zero if their topics have changed."""
        before, self._topics = self._topics, topics
        self._drop(ref for ref in before if before[ref] != topics.get(ref))
        measured = {ref.nodelet for ref in topics}
        self.strains = {name: each for name, each in self.strains.items() if name in measured}

    def _strain(self, counted: Sequence[NodeletCount]) -> None:
        first, last = counted[0], counted[-1]
        load = last.load_since(first) or NodeletLoad(0.0, None, None)
        share = load.busy if load.cpu is None else load.cpu
        self.strains[last.nodelet] = Strain(min(share, 1.0), last.recent_error)

    def _forget(self, nodelets: set[str]) -> None:
        if nodelets:
            self._drop(ref for ref in self._topics if ref.nodelet in nodelets)

    def _drop(self, refs: Iterable[PortRef]) -> None:
        for ref in refs:
            self._tracks.pop(ref, None)
            self.traffic.pop(ref, None)


def _is_less(now: NodeletCount, before: NodeletCount) -> bool:
    """Whether messages were counted before that are not now: the nodelet was loaded again."""
    return any(
        now.ports[port].messages < count.messages
        for port, count in before.ports.items()
        if port in now.ports
    )


def _number(value: float) -> str:
    if value == 0:
        return "0"
    if value < 0.995:
        return f"{value:.2f}"
    return f"{value:.1f}" if value < 9.95 else f"{value:.0f}"


@dataclass(frozen=True)
class PortVerdict:
    """The first of the last equal verdicts from an out-port; None before there is one.

    Its formula has the tags of the stream of verdicts, or else the formula.
    """

    formula: str
    verdict: Verdict | None

    @property
    def truth(self) -> Truth:
        return Truth.UNKNOWN if self.verdict is None else self.verdict.value

    @property
    def text(self) -> str:
        if self.verdict is None:
            return f"{self.formula}: no verdict yet"
        since = f"{self.verdict.value.name} since {self.verdict.since / 1e9:.3f}"
        return f"{self.formula}: {since}\n{self.verdict.why}".rstrip()


def verdict_sources(nodelets: Iterable[NodeletStatus]) -> frozenset[tuple[str, str]]:
    """Find the nodes that publish verdicts now, each with the topic."""
    ports = _ports_of_verdicts(nodelets)
    return frozenset(
        (each.node, port.topic) for each, port in ports if each.state is State.RUNNING
    )


def port_verdicts(
    nodelets: Iterable[NodeletStatus],
    verdicts: Mapping[str, Verdict | None],
    streams: Iterable[StreamStatus],
) -> dict[PortRef, PortVerdict]:
    """Find the last verdict, by topic, of each out-port.

    Claims have the bindings of the variables in tags of ports.
    """
    tags: dict[str, list[str]] = {}
    for stream in streams:
        if not stream.state.ended:
            tags.setdefault(stream.topic, []).append(stream.bound_tag)
    found = {}
    for nodelet, port in _ports_of_verdicts(nodelets):
        formulas = [each.text for each in nodelet.parameters if each.name == "formula"]
        words = tags.get(port.topic) or port.tags or formulas or [port.name]
        formula = ", ".join(sorted(set(words)))
        found[PortRef(nodelet.name, port.name)] = PortVerdict(formula, verdicts.get(port.topic))
    return found


def _ports_of_verdicts(
    nodelets: Iterable[NodeletStatus],
) -> Iterator[tuple[NodeletStatus, PortState]]:
    for nodelet in nodelets:
        for port in nodelet.ports:
            if port.direction != IN and port.datatype == VERDICT and port.topic:
                yield nodelet, port
