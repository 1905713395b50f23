# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The messages that the parts of streams have sent: counts, silences, ages.

Nodelets are polled for the counts of their out-ports. Topics of ordinary nodes, and of nodelets in
stock C++ managers, are listened to, since their publishers cannot be polled. So are those of other
C++ nodelets that must send steadily and that no nodelet listens to: a lazy one sends only to
subscribers.

A count holds for one moment between the question and the answer. Every conclusion holds for any
such moment, so a slow network makes conclusions late, but not wrong. A count that could not be
read allows none.
"""

from __future__ import annotations

import collections
import itertools
from dataclasses import dataclass, field
from typing import Callable, Iterable, Mapping, NamedTuple, Tuple

from dyknow.manager.claim import Claim
from dyknow.manager.graph import Graph
from dyknow.manager.host import Count, Host, Listening
from dyknow.manager.record import Record
from dyknow.model.graph import State
from dyknow.model.transformation import IN, OUT

#: Seconds without an answer after which a nodelet is unresponsive.
UNANSWERED = 2.0
#: Seconds between two questions to an unresponsive nodelet.
_RETRY = 0.5
#: Seconds that a part may take to begin, before its rate is judged.
GRACE = 2.0
#: Seconds over which a rate is taken at least.
WINDOW = 4.5
#: Ages that are judged together, and seconds that lie between two of them at the least.
SAMPLES = 9
_SPACING = 0.4

Place = Tuple[str, str]
"""A nodelet and its out-port, or an empty name and a topic."""

_NEVER = float("-inf")


class Sample(NamedTuple):
    """The age of a message in seconds, None if not known, and the time of its query."""

    age: float | None
    asked: float


@dataclass
class Flow:
    """The messages of one place since its nodelet was loaded; moments are steady seconds.

    Attributes:
        last: the latest count.
        quiet_from: the last message had come by then.
        quiet_until: no other had come until then.
        came_after: a message that was noticed came after this moment.
        counts: the latest counts without a gap, for rates.
        samples: ages of the latest messages.
    """

    last: Count
    quiet_from: float
    quiet_until: float
    came_after: float = _NEVER
    counts: collections.deque[Count] = field(default_factory=collections.deque)
    samples: collections.deque[Sample] = field(
        default_factory=lambda: collections.deque(maxlen=SAMPLES)
    )
    _counting_since: float = 0.0
    _sampled: Count | None = None

    @property
    def silence(self) -> float:
        """Seconds for which certainly no message came."""
        return self.quiet_until - self.quiet_from

    @property
    def begun(self) -> bool:
        """Whether any message has come."""
        return self.last.messages > 0

    def add(self, count: Count, window: float) -> bool:
        """Take a count in, and keep those of a window; returns whether messages have come."""
        came = count.messages > self.last.messages
        if came:
            self.came_after, self.quiet_from = self.quiet_until, count.answered
        self.quiet_until = count.asked
        self._add_for_rate(count, window)
        if self._sampled is None:
            self._sampled = count
        elif (
            count.messages > self._sampled.messages
            and count.asked - self._sampled.asked >= _SPACING
        ):
            self.samples.append(Sample(count.age, self._sampled.answered))
            self._sampled = count
        self.last = count
        return came

    def _add_for_rate(self, count: Count, window: float) -> None:
        counts = self.counts
        if counts and count.asked - counts[-1].answered > UNANSWERED:
            counts.clear()  # its process may have been stopped
        if not counts:
            self._counting_since = count.answered
        elif count.messages == counts[0].messages and count.asked - self._counting_since < GRACE:
            counts.clear()  # it has not begun to send
        counts.append(count)
        while len(counts) > 2 and count.asked - counts[1].answered >= window:
            counts.popleft()


class FlowMeter:
    """Counts messages at the places that it is given, and keeps a flow for each."""

    def __init__(
        self, host: Host, graph: Graph, clock: Callable[[], float], running: Callable[[], float]
    ) -> None:
        self._host = host
        self._graph = graph
        self._clock = clock
        self._running = running
        #: The flow of each place that was counted.
        self.flows: dict[Place, Flow] = {}
        #: Nodelets that do not answer.
        self.unresponsive: frozenset[str] = frozenset()
        self._unresponsive: dict[str, list[Place]] = {}
        self._unanswered_since: dict[str, float] = {}
        self._asked: dict[str, float] = {}
        self._listening: dict[str, Listening] = {}
        self._parts: dict[str, StreamParts] = {}
        self._parts_at = -1

    def parts(self, claim: Claim) -> StreamParts:
        """Return the places of a claim's stream; read again only after a change."""
        if self._parts_at != self._graph.revision:
            self._parts_at = self._graph.revision  # first: a change meanwhile counts the next time
            self._parts = {}
        known = self._parts.get(claim.claim_id)
        if known is None or known.claim is not claim:
            known = self._parts[claim.claim_id] = StreamParts(claim, self._graph)
        return known

    def restart(self, names: Iterable[str]) -> None:
        """Judge nodelets that were connected elsewhere by what they send from now on."""
        names = set(names)
        for (name, _), flow in self.flows.items():
            if name in names:
                flow.quiet_from = self._clock()
                flow.counts.clear()

    def read(
        self,
        awaited: Mapping[Place, float],
        steady: Mapping[Place, float],
        windows: Mapping[Place, float],
    ) -> set[Place]:
        """Count where a count is due; flows of other places are forgotten.

        Args:
            awaited: seconds between two counts, by place where a message is awaited.
            steady: the same, by place that must send steadily.
            windows: seconds over which rates of places are taken, if they are long.

        Returns the places where messages have come.
        """
        records = self._graph.records
        running = {name for name, each in records.items() if each.state is State.RUNNING}
        self._unresponsive = {
            name: places for name, places in self._unresponsive.items() if name in running
        }
        # An unresponsive nodelet is polled until it answers, whether a claim needs it or not.
        retried = {place: _RETRY for places in self._unresponsive.values() for place in places}
        wanted: dict[Place, float] = {}
        for place, period in itertools.chain(retried.items(), awaited.items(), steady.items()):
            wanted[place] = min(wanted.get(place, period), period)
        self.flows = {place: flow for place, flow in self.flows.items() if place in wanted}
        topics: dict[str, list[Place]] = {}
        asked: dict[str, dict[str, list[Place]]] = {}
        for place in sorted(wanted):
            name, port = place
            record = records.get(name)
            if not name:
                topics.setdefault(port, []).append(place)
            elif record is not None and record.is_fixed:
                topics.setdefault(record.topics.get(port, ""), []).append(place)
            elif record is not None:
                asked.setdefault(record.manager, {}).setdefault(name, []).append(place)
        for topic in self._unheard(steady, records):
            topics.setdefault(topic, [])
        counted = {**self._listen(topics), **self._ask(asked, wanted)}
        self.unresponsive = self._all_unresponsive(asked, records)
        return {
            place
            for place, count in counted.items()
            if self._add(place, count, windows.get(place, WINDOW))
        }

    def _add(self, place: Place, count: Count, window: float) -> bool:
        flow = self.flows.get(place)
        if flow is None or count.messages < flow.last.messages:  # the nodelet was loaded again
            flow = self.flows[place] = Flow(count, count.answered, count.asked)
        return flow.add(count, window)

    def _unheard(self, steady: Iterable[Place], records: Mapping[str, Record]) -> set[str]:
        """Topics of C++ nodelets that no nodelet listens to."""
        lazy = {
            records[name].topics.get(port, "")
            for name, port in steady
            if name in records and not records[name].kind.is_written_for_dyknow
        }
        if not lazy:
            return set()
        ports = (port for record in records.values() for port in record.ports)
        return lazy - {port.topic for port in ports if port.direction == IN}

    def _listen(self, topics: Mapping[str, list[Place]]) -> dict[Place, Count]:
        for topic in [topic for topic in self._listening if topic not in topics]:
            self._listening.pop(topic).close()
        found: dict[Place, Count] = {}
        for topic in sorted(topics.keys() - {""}):
            if topic not in self._listening:
                self._listening[topic] = self._host.listen(topic)
            count = self._listening[topic].count()
            if count is not None:
                found.update(dict.fromkeys(topics[topic], count))
        return found

    def _ask(
        self, asked: Mapping[str, Mapping[str, list[Place]]], periods: Mapping[Place, float]
    ) -> dict[Place, Count]:
        now, began = self._clock(), self._running()
        self._asked = {manager: self._asked.get(manager, _NEVER) for manager in asked}
        due = []
        for manager in sorted(asked):
            periods_here = [periods[place] for each in asked[manager].values() for place in each]
            if self._asked[manager] + min(periods_here) <= now:
                due.append(manager)
                self._asked[manager] = now
        answers = self._host.counts({each: list(asked[each]) for each in due}) if due else {}
        found: dict[Place, Count] = {}
        for manager in due:
            for name, places in asked[manager].items():
                counts = answers.get(name)
                if counts is not None:
                    self._unanswered_since.pop(name, None)
                    if self._unresponsive.pop(name, None):  # its process may have been stopped
                        for place in places:
                            self.flows.pop(place, None)
                    found.update({each: counts[each[1]] for each in places if each[1] in counts})
                    continue
                if name in answers:  # its process answers, and does not run it
                    self._unanswered_since.pop(name, None)
                    self._unresponsive[name] = places
                elif self._is_late(name, began):
                    self._unresponsive[name] = places
        return found

    def _is_late(self, name: str, began: float) -> bool:
        since = self._unanswered_since.setdefault(name, began)
        return self._running() - since >= UNANSWERED

    def _all_unresponsive(
        self, asked: Mapping[str, Iterable[str]], records: Mapping[str, Record]
    ) -> frozenset[str]:
        """Return the nodelets that do not answer, with all others of a process that hangs."""
        known = {name for names in asked.values() for name in names}
        self._unanswered_since = {
            name: since for name, since in self._unanswered_since.items() if name in known
        }
        late = self._unresponsive.keys() & self._unanswered_since.keys()
        hanging = {records[name].manager for name in late}
        others = [each.name for each in records.values() if each.manager in hanging]
        return frozenset({*self._unresponsive, *others})


class StreamParts:
    """Out-ports and ordinary topics of a claim, by the topics on which they send."""

    def __init__(self, claim: Claim, graph: Graph) -> None:
        self.claim = claim
        self.topics: dict[Place, str] = {("", topic): topic for topic in claim.sources}
        for name in claim.nodelets:
            record = graph.find(name)
            if record is not None and record.transformation and record.state is State.RUNNING:
                ports = record.transformation.ports
                outs = {port.name for port in ports if port.direction == OUT}
                for port, topic in claim.wiring[name].items():
                    if port in outs:
                        self.topics[(name, port)] = topic
        self._senders: dict[str, list[Place]] = {}
        for place, topic in sorted(self.topics.items()):
            self._senders.setdefault(topic, []).append(place)

    @property
    def goal(self) -> Place:
        """The place that publishes on the topic of the client."""
        return goal_of(self.claim)

    def suppliers(self, place: Place) -> list[list[Place]]:
        """List the suppliers of a place, by in-port of its nodelet."""
        name, _ = place
        topics = self.claim.wiring.get(name, {}).values()
        feeding = [
            [each for each in self._senders.get(topic, ()) if each[0] != name] for topic in topics
        ]
        return [senders for senders in feeding if senders]


def goal_of(claim: Claim) -> Place:
    """Return the place that publishes on the topic of a claim's client."""
    return claim.goal if claim.goal[0] else ("", claim.topic)


def name_of(place: Place) -> str:
    """Name of the nodelet, or of the topic where there is none."""
    return place[0] or place[1]


def described(place: Place) -> str:
    """Name a place for people."""
    return f"nodelet {place[0]}" if place[0] else f"topic {place[1]}"
