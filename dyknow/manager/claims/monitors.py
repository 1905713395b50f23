# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which parts of streams are silent, and whose first message has come: judged by the counts."""

from __future__ import annotations

import logging
from typing import Callable, Dict, FrozenSet, Iterable, List, Mapping, Set

from dyknow.manager.claim import Claim
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.flows import FlowMeter, Place
from dyknow.manager.claims.quality import QualityMonitor
from dyknow.manager.claims.stream_parts import StreamParts, described, goal_of, name_of
from dyknow.manager.graph import Graph
from dyknow.manager.manager import Manager
from dyknow.model.streams import NO_MESSAGE, UNKNOWN_AGE, ClaimState

#: Seconds that a part may take to send its first message, if the claim does not allow more.
FIRST_MESSAGE = 2.0
#: Seconds between two counts while a first message is awaited.
_FIRST_MESSAGE_PERIOD = 0.25
#: Counts in the time for which a part may be silent, and the least seconds between two.
_COUNTS = 4
_LEAST_PERIOD = 0.05

_log = logging.getLogger("rosout.dyknow")


class StreamMonitor:
    """Watches the messages of all streams."""

    def __init__(
        self,
        manager: Manager,
        table: ClaimTable,
        clock: Callable[[], float],
        running: Callable[[], float],
    ) -> None:
        """Begin without any stream.

        Args:
            manager: knows the nodelets, and reaches their host.
            table: the claims.
            clock: steady time, in seconds.
            running: time for which this process has run, in seconds.
        """
        self._table = table
        self._meter = FlowMeter(manager.host, manager.graph, clock, running)
        self._silence = SilenceMonitor(self._meter, manager.graph)
        self._first_messages = FirstMessageMonitor(table, self._meter, manager.graph, clock)
        #: Which claims get less than they demand, and what is to blame.
        self.quality = QualityMonitor(self._meter, manager.graph, clock, manager.existing_topics)

    @property
    def silent(self) -> Mapping[str, str]:
        """Silent nodelets and topics, each with a sentence about it."""
        return self._silence.silent

    @property
    def unresponsive(self) -> FrozenSet[str]:
        """Nodelets that do not answer."""
        return self._meter.unresponsive

    @property
    def unhealthy(self) -> FrozenSet[str]:
        """What is silent or unresponsive."""
        return self.unresponsive | frozenset(self.silent)

    def read(self) -> List[str]:
        """Count messages; returns the nodelets and topics that have just fallen silent."""
        claims = self._table.living()
        came = self._meter.read(
            self._first_messages.periods(claims),
            self._silence.periods(claims),
            self.quality.periods(claims),
        )
        self.quality.judge(claims)
        fallen = self._silence.judge(claims, came)
        for name in fallen:
            _log.warning("%s", self.silent[name])
        return fallen

    def service(self, name: str, lifetime: float) -> float:
        """Seconds for which a nodelet that lived so long has sent messages; all if not watched."""
        flows = [flow for (each, _), flow in list(self._meter.flows.items()) if each == name]
        silences = [flow.silence if flow.begun else lifetime for flow in flows]
        return max(0.0, lifetime - max(silences, default=0.0))

    def restart(self, claim: Claim, goal: Place, topic: str, rewired: Iterable[str]) -> str:
        """Restart with a stream that was changed just now; returns the detail of its claim.

        Args:
            claim: whose stream it is.
            goal: nodelet and out-port that publish it; empty for a topic of ordinary nodes.
            topic: where it is published.
            rewired: its nodelets that were connected elsewhere.
        """
        self._meter.restart_silence(rewired)
        self.quality.restart(claim.claim_id, rewired)
        return self._first_messages.expect(claim, goal, topic)

    def report_first_messages(self) -> None:
        """Change the claims whose first message has come, by the latest counts."""
        self._first_messages.report()

    def report_unknown_ages(self) -> None:
        """Say in the details of claims where nobody can know how old their messages are."""
        for claim in self._table.living():
            if claim.request.max_age and claim.state is ClaimState.ACTIVE:
                is_unknown = self.quality.is_age_unknown(claim)
                if is_unknown and not claim.detail:
                    self._table.change(claim.claim_id, UNKNOWN_AGE, detail=UNKNOWN_AGE)
                elif claim.detail == UNKNOWN_AGE and not is_unknown:
                    reason = "it is known how old its messages are"
                    self._table.change(claim.claim_id, reason, detail="")


class SilenceMonitor:
    """Finds parts of streams that have fallen silent, where a claim has a ``max_silence``.

    A part is to blame only if what feeds it has sent something since its own last message: of a
    chain that is silent that is the first part, and it is none as long as a count from further up
    is due. The same counts lead to the same judgement, whenever it is made.
    """

    def __init__(self, meter: FlowMeter, graph: Graph) -> None:
        """Begin with no part silent.

        Args:
            meter: the counts.
            graph: the nodelets.
        """
        self._meter = meter
        self._graph = graph
        #: Silent nodelets and topics, each with a sentence about it.
        self.silent: Dict[str, str] = {}

    def periods(self, claims: Iterable[Claim]) -> Dict[Place, float]:
        """Seconds between two counts, by place."""
        found: Dict[Place, float] = {}
        for claim in _watched(claims):
            period = max(claim.request.max_silence / _COUNTS, _LEAST_PERIOD)
            for place in StreamParts(claim, self._graph).topics:
                found[place] = min(found.get(place, period), period)
        for place in self._meter.flows:
            if place[0] in self.silent and self._graph.find(place[0]) is not None:
                found.setdefault(place, FIRST_MESSAGE / _COUNTS)
        return found

    def judge(self, claims: Iterable[Claim], came: Iterable[Place]) -> List[str]:
        """Judge by the latest counts.

        Args:
            claims: those whose parts are watched, among others.
            came: places where messages have come since the last judgement.

        Returns:
            The nodelets and topics that have just fallen silent.
        """
        for place in came:
            self.silent.pop(name_of(place), None)
        counted = set(map(name_of, self._meter.flows))
        for name in [name for name in self.silent if name not in counted]:
            del self.silent[name]
        fallen: Set[str] = set()
        for claim in _watched(claims):
            fallen.update(self._judge(StreamParts(claim, self._graph)))
        return sorted(fallen)

    def _judge(self, parts: StreamParts) -> Set[str]:
        limit = parts.claim.request.max_silence
        fallen = set()
        for place in sorted(parts.topics):
            flow, name = self._meter.flows.get(place), name_of(place)
            if flow is None or name in self.silent:
                continue
            allowed = limit if flow.begun else max(limit, FIRST_MESSAGE)
            if flow.silence > allowed and self._is_fed(place, parts):
                self.silent[name] = f"{described(place)} was silent for longer than {limit:g} s"
                fallen.add(name)
        return fallen

    def _is_fed(self, place: Place, parts: StreamParts) -> bool:
        """Whether all that feeds a place has sent something since its last message."""
        flows = self._meter.flows
        since = flows[place].quiet_from
        return all(
            any(each in flows and flows[each].came_after >= since for each in senders)
            for senders in parts.feeders(place)
        )


class FirstMessageMonitor:
    """Keeps ``NO_MESSAGE`` in the detail of a claim until the first message of its stream.

    A stream can be wired as it should be and yet carry no messages, so each change of a stream
    raises the question again. Counts that nodelets keep anyway answer it. DyKnow does not
    subscribe to a topic merely to find out: where the publisher cannot be asked, the claim says
    so.
    """

    def __init__(
        self, table: ClaimTable, meter: FlowMeter, graph: Graph, clock: Callable[[], float]
    ) -> None:
        """Begin with no message awaited.

        Args:
            table: the claims.
            meter: the counts.
            graph: the nodelets.
            clock: steady time, in seconds.
        """
        self._table = table
        self._meter = meter
        self._graph = graph
        self._clock = clock
        self._since: Dict[str, float] = {}

    def expect(self, claim: Claim, goal: Place, topic: str) -> str:
        """Begin to wait, now that a claim's stream was changed; returns the claim's detail."""
        self._since[claim.claim_id] = self._clock()
        record = self._graph.find(goal[0])
        can_be_asked = record is not None and not record.rewired_by_reload
        limits = (claim.request.max_silence, claim.request.min_rate, claim.request.max_age)
        if can_be_asked or any(limits):  # with a limit the topic is listened to
            return NO_MESSAGE
        return f"not known whether messages come: the publisher of {topic} cannot be asked"

    def periods(self, claims: Iterable[Claim]) -> Dict[Place, float]:
        """Seconds between two counts, by place."""
        return {goal_of(claim): _FIRST_MESSAGE_PERIOD for claim in claims if _waits(claim)}

    def report(self) -> None:
        """Change the claims whose first message has come."""
        waiting = [claim for claim in self._table.living() if _waits(claim)]
        since = {each.claim_id: self._since.get(each.claim_id, self._clock()) for each in waiting}
        self._since = since
        for claim in waiting:
            if self._meter.has_come(goal_of(claim), since[claim.claim_id]):
                self._table.change(claim.claim_id, "its first message has come", detail="")


def _watched(claims: Iterable[Claim]) -> List[Claim]:
    return [each for each in claims if each.request.max_silence > 0 and each.topic]


def _waits(claim: Claim) -> bool:
    return claim.state is ClaimState.ACTIVE and claim.detail == NO_MESSAGE
