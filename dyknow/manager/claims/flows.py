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
from dataclasses import dataclass, field
from typing import AbstractSet, Callable, Iterable, Mapping, NamedTuple, Tuple

from dyknow.manager.claim import Claim
from dyknow.manager.graph import Graph
from dyknow.manager.host import Count, Host, Listening
from dyknow.manager.record import Record
from dyknow.model.graph import State
from dyknow.model.transformation import IN, OUT

#: Seconds without an answer after which a nodelet is unresponsive.
_UNANSWERED = 2.0
#: Seconds between two questions to an unresponsive nodelet.
_RETRY = 0.5
#: Seconds that a part may take to begin, before its rate is judged.
_GRACE = 2.0
#: Seconds over which a rate is taken at least.
WINDOW = 4.5
#: Ages that are judged together, and seconds that lie between two of them at the least.
SAMPLES = 9
_SPACING = 0.4
#: Before every moment.
NEVER = float("-inf")

Place = Tuple[str, str]
"""A nodelet and its out-port, or an empty name and a topic."""


class Watch(NamedTuple):
    """How a place is counted."""

    period: float  # seconds between two counts
    #: Seconds over which its rate is taken, at least; 0 if only its next message is awaited, which
    #: it need not send without a subscriber.
    window: float = 0.0

    def merged(self, other: Watch | None) -> Watch:
        """Return how it is counted for two purposes."""
        if other is None:
            return self
        return Watch(min(self.period, other.period), max(self.window, other.window))


class Span(NamedTuple):
    """Two counts of one place."""

    first: Count
    last: Count

    @property
    def messages(self) -> int:
        """Messages between the two."""
        return self.last.messages - self.first.messages

    @property
    def seconds(self) -> float:
        """Seconds that certainly lie between them."""
        return self.last.asked - self.first.answered

    @property
    def rate(self) -> float:
        """About how many messages a second there were, in Hz."""
        return self.messages / self.seconds


@dataclass
class Flow:
    """The messages of one place since its nodelet was loaded; moments are steady seconds."""

    last: Count  # the latest count
    quiet_from: float  # the last message had come by then
    quiet_until: float  # no other had come until then
    came_after: float = NEVER  # a message that was noticed came after this moment
    is_sending: bool = False  # whether messages had come by the latest count
    #: The latest counts without a gap, for rates.
    counts: collections.deque[Count] = field(default_factory=collections.deque)
    _counting_since: float = 0.0
    #: Counts between each two of which messages came, for ages.
    _samples: collections.deque[Count] = field(
        default_factory=lambda: collections.deque(maxlen=SAMPLES + 1)
    )

    @property
    def silence(self) -> float:
        """Seconds for which certainly no message came."""
        return self.quiet_until - self.quiet_from

    @property
    def begun(self) -> bool:
        """Whether any message has come."""
        return self.last.messages > 0

    @property
    def is_latched(self) -> bool:
        """Whether its last message is kept for subscribers, so that it may be the only one."""
        return self.last.latched and self.begun

    def add(self, count: Count, window: float) -> None:
        """Take a count in, and keep those of a window."""
        self.is_sending = count.messages > self.last.messages
        if self.is_sending:
            self.came_after, self.quiet_from = self.quiet_until, count.answered
        self.quiet_until = count.asked
        self._add_for_rate(count, window)
        last = self._samples[-1] if self._samples else None
        if last is None or (
            count.messages > last.messages and count.asked - last.asked >= _SPACING
        ):
            self._samples.append(count)
        self.last = count

    def _add_for_rate(self, count: Count, window: float) -> None:
        counts = self.counts
        if counts and count.asked - counts[-1].answered > _UNANSWERED:
            counts.clear()  # its process may have been stopped
        if not counts:
            self._counting_since = count.answered
        elif count.messages == counts[0].messages and count.asked - self._counting_since < _GRACE:
            counts.clear()  # it has not begun to send
        counts.append(count)
        while len(counts) > 2 and count.asked - counts[1].answered >= window:
            counts.popleft()

    def span(self, window: float) -> Span | None:
        """Return the shortest span of a window at least, up to the latest count."""
        for first in reversed(self.counts):
            span = Span(first, self.counts[-1])
            if span.seconds >= window:
                return span
        return None

    def ages(self, since: float = NEVER) -> list[float]:
        """Known ages of the latest messages that were sent after a moment."""
        samples = list(self._samples)
        return [
            each.age
            for before, each in zip(samples, samples[1:])
            if each.age is not None and before.answered >= since
        ]

    @property
    def is_age_unknown(self) -> bool:
        """Whether enough messages have come, and the age of none of them is known."""
        return len(self._samples) > SAMPLES and not self.ages()


Flows = Mapping[Place, Flow]


class Stream:
    """The stream of a claim: its parts, and their messages since it was connected last."""

    def __init__(self, claim: Claim, now: float) -> None:
        self.claim = claim  # whose it is
        self.changed = now  # when it was changed last, or made whole again
        #: Out-ports and ordinary topics, each with the topic on which it sends.
        self.topics: dict[Place, str] = {}
        #: The highest rate of each place while the stream was fast enough (Hz).
        self.usual: dict[Place, float] = {}
        self._connected = NEVER
        #: The first and the last moment at which it kept a limit, by the limit's name.
        self._good: dict[str, tuple[float, float]] = {}
        self._senders: dict[str, list[Place]] = {}
        self._read_at = -1

    def connected(self, now: float) -> None:
        """Forget the messages that came before parts were connected elsewhere."""
        self._connected = now
        self.usual, self._good = {}, {}

    def follow(self, claim: Claim, graph: Graph) -> Stream:
        """Read the parts of the stream, if anything has changed."""
        revision = graph.revision  # first: a change meanwhile counts the next time
        if self.claim is claim and self._read_at == revision:
            return self
        self.claim, self._read_at = claim, revision
        self.topics = {("", topic): topic for topic in claim.sources}
        for name in claim.nodelets:
            record = graph.find(name)
            if name == claim.monitor:
                continue  # it judges the stream, and is no part of it
            if record is not None and record.state is State.RUNNING:
                outs = {port.name for port in record.declared if port.direction == OUT}
                for port, topic in claim.wiring[name].items():
                    if port in outs:
                        self.topics[name, port] = topic
        self._senders = {}
        for place, topic in sorted(self.topics.items()):
            self._senders.setdefault(topic, []).append(place)
        return self

    @property
    def goal(self) -> Place:
        """The place that publishes on the topic of the client."""
        return self.claim.goal if self.claim.goal[0] else ("", self.claim.topic)

    def suppliers(self, place: Place) -> list[list[Place]]:
        """List the suppliers of a place, by in-port of its nodelet."""
        name, _ = place
        topics = self.claim.wiring.get(name, {}).values()
        feeding = [
            [each for each in self._senders.get(topic, ()) if each[0] != name] for topic in topics
        ]
        return [senders for senders in feeding if senders]

    def fed_by(self, nodelets: Iterable[str]) -> set[str]:
        """Return nodelets, and those of the stream that they feed."""
        found, size = {*nodelets}, -1
        while len(found) > size:
            size = len(found)
            found |= {
                place[0]
                for place in self.topics
                if any(name in found for each in self.suppliers(place) for name, _ in each)
            }
        return found

    def ages(self, place: Place, flows: Flows) -> list[float]:
        """Known ages of the messages of a place since it was connected."""
        return flows[place].ages(self._connected) if place in flows else []

    def note_good(self, limit: str, now: float) -> None:
        since, _ = self._good.get(limit, (now, now))
        self._good[limit] = since, now

    def served(self, limit: str) -> float:
        """Seconds for which it kept a limit."""
        since, until = self._good.get(limit, (0.0, 0.0))
        return until - since


@dataclass(frozen=True)
class _Unanswered:
    """Questions for the counts of a nodelet without an answer."""

    places: list[Place]  # those that were counted
    since: float  # the first of these questions, in seconds for which this process has run
    latest: float  # the time without an answer to the latest one
    #: Whether its process may run it; if not, the process has answered without it.
    is_listed: bool = True

    @property
    def is_late(self) -> bool:
        return self.latest - self.since >= _UNANSWERED


class FlowMeter:
    """Counts messages at the places that it is given, and keeps a flow for each."""

    def __init__(
        self, host: Host, graph: Graph, clock: Callable[[], float], running: Callable[[], float]
    ) -> None:
        self._host = host
        self._graph = graph
        self._clock = clock
        self._running = running
        self._paused = clock() - running()  # seconds for which this process had not run
        self.flows: dict[Place, Flow] = {}  # the flow of each place that was counted
        #: Nodelets that do not answer, with all nodelets of a process that hangs.
        self.unresponsive: frozenset[str] = frozenset()
        self._unanswered: dict[str, _Unanswered] = {}
        self._asked: dict[str, float] = {}
        self._listening: dict[str, Listening] = {}

    def restart(self, names: AbstractSet[str]) -> None:
        """Judge nodelets that were connected elsewhere by their messages from now on."""
        for (name, _), flow in self.flows.items():
            if name in names:
                flow.quiet_from = self._clock()
                flow.counts.clear()

    def read(self, wanted: Mapping[Place, Watch]) -> None:
        """Count where a count is due; flows of other places are forgotten."""
        now = self._clock()
        paused = now - self._running()
        for each in self.flows.values():  # nothing could send while all stood still
            each.quiet_from = min(now, each.quiet_from + paused - self._paused)
        self._paused = paused
        records, wanted = self._graph.records, dict(wanted)
        # An unresponsive nodelet is polled until it answers, whether a claim needs it or not.
        for name in self.unresponsive & self._unanswered.keys():
            if name in records and records[name].state is State.RUNNING:
                for place in self._unanswered[name].places:
                    wanted[place] = Watch(_RETRY).merged(wanted.get(place))
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
        for topic in self._unheard(wanted, records):
            topics.setdefault(topic, [])
        counts = self._ask(asked, wanted, records)
        for place, count in {**self._listen(topics), **counts}.items():
            flow = self.flows.get(place)
            if flow is None or count.messages < flow.last.messages:  # the nodelet is a new one
                flow = self.flows[place] = Flow(count, count.answered, count.asked)
            flow.add(count, max(wanted[place].window, WINDOW))
        known = {name for names in asked.values() for name in names}
        self._unanswered = {key: each for key, each in self._unanswered.items() if key in known}
        hanging = {
            records[name].manager
            for name, each in self._unanswered.items()
            if each.is_listed and each.is_late
        }
        gone = {name for name, each in self._unanswered.items() if not each.is_listed}
        self.unresponsive = frozenset(
            name for name, each in records.items() if name in gone or each.manager in hanging
        )

    def _unheard(self, wanted: Mapping[Place, Watch], records: Mapping[str, Record]) -> set[str]:
        """Topics of C++ nodelets that have to send steadily, and that no nodelet listens to."""
        lazy = {
            records[name].topics.get(port, "")
            for (name, port), watch in wanted.items()
            if watch.window and name in records and not records[name].kind.is_written_for_dyknow
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
        self,
        asked: Mapping[str, Mapping[str, list[Place]]],
        wanted: Mapping[Place, Watch],
        records: Mapping[str, Record],
    ) -> dict[Place, Count]:
        now, began = self._clock(), self._running()
        periods = {
            manager: min(wanted[place].period for places in names.values() for place in places)
            for manager, names in asked.items()
        }
        self._asked = {manager: self._asked.get(manager, NEVER) for manager in asked}
        due = [each for each in sorted(asked) if self._asked[each] + periods[each] <= now]
        self._asked.update(dict.fromkeys(due, now))
        answers = self._host.counts({each: list(asked[each]) for each in due}) if due else {}
        found: dict[Place, Count] = {}
        for name, places in [pair for manager in due for pair in asked[manager].items()]:
            counts, before = answers.get(name), self._unanswered.pop(name, None)
            if counts is not None:
                if name in self.unresponsive and before is not None:
                    for place in places:  # its process may have been stopped
                        self.flows.pop(place, None)
                found.update({each: counts[each[1]] for each in places if each[1] in counts})
            elif name in answers:  # its process answers, and does not run it
                is_same = self._graph.find(name) is records[name]
                if name in self._graph.restarting or not is_same:
                    continue  # it may have been restarted meanwhile
                self._unanswered[name] = _Unanswered(places, began, began, is_listed=False)
            else:
                since = began if before is None else before.since
                self._unanswered[name] = _Unanswered(places, since, self._running())
        return found
