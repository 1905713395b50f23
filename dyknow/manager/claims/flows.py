# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How many messages the parts of streams have sent, and in which spans of time they sent none.

Nodelets are polled for the counts of their out-ports. Topics of ordinary nodes, and of nodelets in
stock C++ managers, whose publishers cannot be polled, are listened to. So are those of other C++
nodelets that must not be silent and that no nodelet listens to: a lazy one sends only to
subscribers. A count holds for one moment between
the question and the answer. Every conclusion drawn here holds for any such moment, so a slow
network makes conclusions late, but not wrong. A count that could not be read allows none.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Callable, Dict, FrozenSet, Iterable, List, Mapping, Set, Tuple

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

Place = Tuple[str, str]
"""A nodelet and its out-port, or an empty name and a topic."""

_NEVER = float("-inf")


@dataclass
class Flow:
    """The messages of one place; moments are seconds of a steady clock.

    Attributes:
        messages: the latest count.
        quiet_from: the last message had come by then.
        quiet_until: no other had come until then.
        came_after: a message that was noticed came after this moment.
        begun: whether any message has come.
        latched: whether one is kept for subscribers that connect later.
    """

    messages: int
    quiet_from: float
    quiet_until: float
    came_after: float = _NEVER
    begun: bool = False
    latched: bool = False

    @property
    def silence(self) -> float:
        """Seconds for which certainly no message came."""
        return self.quiet_until - self.quiet_from


class FlowMeter:
    """Counts messages at the places that it is given, and keeps a flow for each."""

    def __init__(
        self,
        host: Host,
        graph: Graph,
        clock: Callable[[], float],
        running: Callable[[], float],
    ) -> None:
        self._parts: Dict[str, StreamParts] = {}
        self._parts_at = -1
        self._running = running
        self._host = host
        self._graph = graph
        self._clock = clock
        self._flows: Dict[Place, Flow] = {}
        #: Counts of the latest reading, by place.
        self.counted: Dict[Place, Count] = {}
        self._listening: Dict[str, Listening] = {}
        self._asked: Dict[str, float] = {}
        self._unanswered_since: Dict[str, float] = {}
        self._unresponsive: Dict[str, List[Place]] = {}

    @property
    def unresponsive(self) -> FrozenSet[str]:
        """Nodelets that do not answer."""
        return frozenset(self._unresponsive)

    @property
    def flows(self) -> Mapping[Place, Flow]:
        """The flow of each place that was counted."""
        return self._flows

    def parts(self, claim: Claim) -> StreamParts:
        """Return the places of a claim's stream; read again only after a change."""
        if self._parts_at != self._graph.revision:
            self._parts_at = self._graph.revision  # first: a change meanwhile counts the next time
            self._parts = {}
        known = self._parts.get(claim.claim_id)
        if known is None or known.claim is not claim:
            known = self._parts[claim.claim_id] = StreamParts(claim, self._graph)
        return known

    def has_come(self, place: Place, since: float) -> bool:
        """Whether a message has certainly come since then, or a latched one is kept."""
        flow = self._flows.get(place)
        return flow is not None and (flow.latched or flow.came_after >= since)

    def restart_silence(self, names: Iterable[str]) -> None:
        """Let the silence of nodelets begin now, since they were connected elsewhere."""
        names = set(names)
        for (name, _), flow in self._flows.items():
            if name in names:
                flow.quiet_from = self._clock()

    def read(self, expected: Mapping[Place, float], *steady: Mapping[Place, float]) -> Set[Place]:
        """Count where a count is due; flows of places that are not named are forgotten.

        Args:
            expected: seconds between two counts, by place where a message is awaited.
            steady: same, by place that must send steadily; the shortest one is used.

        Returns:
            The places where messages have come.
        """
        self.counted = {}
        records = {record.name: record for record in self._graph.all()}
        running = {name for name, each in records.items() if each.state is State.RUNNING}
        self._unresponsive = {
            name: places for name, places in self._unresponsive.items() if name in running
        }
        # An unresponsive nodelet is polled until it answers, whether a claim needs it or not.
        wanted = {place: _RETRY for places in self._unresponsive.values() for place in places}
        for periods in (expected, *steady):
            for place, period in periods.items():
                wanted[place] = min(wanted.get(place, period), period)
        topics: Dict[str, List[Place]] = {}
        asked: Dict[str, Dict[str, List[Place]]] = {}
        for place in sorted(wanted):
            name, port = place
            record = records.get(name)
            if not name:
                topics.setdefault(port, []).append(place)
            elif record is None:
                continue
            elif record.is_fixed:
                topics.setdefault(record.topics.get(port, ""), []).append(place)
            else:
                asked.setdefault(record.manager, {}).setdefault(name, []).append(place)
        for place in [place for place in self._flows if place not in wanted]:
            del self._flows[place]
        for topic in self._unheard(itertools.chain(*steady), records):
            topics.setdefault(topic, [])
        return self._listen(topics) | self._ask(asked, wanted)

    def _unheard(self, steady: Iterable[Place], records: Mapping[str, Record]) -> Set[str]:
        """Topics of C++ nodelets that no nodelet listens to."""
        lazy = [
            (records[name], port)
            for name, port in steady
            if name in records and not records[name].kind.is_written_for_dyknow
        ]
        if not lazy:
            return set()
        heard = {
            port.topic
            for record in records.values()
            for port in record.ports
            if port.direction == IN
        }
        return {record.topics.get(port, "") for record, port in lazy} - heard

    def _listen(self, topics: Mapping[str, List[Place]]) -> Set[Place]:
        for topic in [topic for topic in self._listening if topic not in topics]:
            self._listening.pop(topic).close()
        came: Set[Place] = set()
        for topic in sorted(topics):
            if topic and topic not in self._listening:
                self._listening[topic] = self._host.listen(topic)
            count = self._listening[topic].count() if topic else None
            for place in topics[topic]:
                if count is not None and self._note(place, count):
                    came.add(place)
        return came

    def _ask(
        self, asked: Mapping[str, Mapping[str, List[Place]]], periods: Mapping[Place, float]
    ) -> Set[Place]:
        now, began = self._clock(), self._running()
        last = {manager: self._asked.get(manager, _NEVER) for manager in asked}
        due = [
            manager
            for manager in sorted(asked)
            if last[manager] + min(periods[p] for each in asked[manager].values() for p in each)
            <= now
        ]
        self._asked = {**last, **dict.fromkeys(due, now)}
        answers = self._host.counts({each: list(asked[each]) for each in due}) if due else {}
        came: Set[Place] = set()
        for name, places in [each for manager in due for each in asked[manager].items()]:
            counts = answers.get(name)
            if counts is None:
                since = self._unanswered_since.setdefault(name, began)
                is_gone = name in answers
                if is_gone or self._running() - since >= UNANSWERED:
                    self._unresponsive[name] = places
                continue
            self._unanswered_since.pop(name, None)
            if self._unresponsive.pop(name, None):  # it may have been stopped: its time restarts
                for place in places:
                    self._flows.pop(place, None)
            for place in places:
                if place[1] in counts and self._note(place, counts[place[1]]):
                    came.add(place)
        known = {name for names in asked.values() for name in names}
        for name in [name for name in self._unanswered_since if name not in known]:
            del self._unanswered_since[name]
        return came

    def _note(self, place: Place, count: Count) -> bool:
        """Take a count in; returns whether messages have come since the last one."""
        self.counted[place] = count
        flow = self._flows.get(place)
        if flow is None or count.messages < flow.messages:  # the nodelet was loaded again
            flow = Flow(count.messages, count.answered, count.asked, begun=count.messages > 0)
            self._flows[place] = flow
        came = count.messages > flow.messages
        if came:
            flow.messages, flow.begun = count.messages, True
            flow.came_after, flow.quiet_from = flow.quiet_until, count.answered
        flow.quiet_until, flow.latched = count.asked, count.latched
        return came


class StreamParts:
    """Out-ports and ordinary topics of a claim.

    Attributes:
        claim: whose stream it is.
        topics: where the messages of each place go.
    """

    def __init__(self, claim: Claim, graph: Graph) -> None:
        """Find the places at which messages can be counted now."""
        self.claim = claim
        self.topics: Dict[Place, str] = {("", topic): topic for topic in claim.sources}
        for name in claim.nodelets:
            record = graph.find(name)
            if (
                record is None
                or record.transformation is None
                or record.state is not State.RUNNING
            ):
                continue
            outs = {port.name for port in record.transformation.ports if port.direction == OUT}
            for port, topic in claim.wiring[name].items():
                if port in outs:
                    self.topics[(name, port)] = topic
        self._senders: Dict[str, List[Place]] = {}
        for place, topic in sorted(self.topics.items()):
            self._senders.setdefault(topic, []).append(place)

    @property
    def goal(self) -> Place:
        """The place that publishes on the topic of the client."""
        return goal_of(self.claim)

    def suppliers(self, place: Place) -> List[List[Place]]:
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
