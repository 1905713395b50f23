# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which parts of streams are silent, and whose first message has come: judged by the counts."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import (
    Callable,
    Dict,
    FrozenSet,
    Hashable,
    Iterable,
    List,
    Mapping,
    Optional,
    Set,
    Tuple,
)

from dyknow.backoff import Backoff
from dyknow.manager.claim import Claim
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.flows import FlowMeter, Place, StreamParts, described, goal_of, name_of
from dyknow.manager.claims.judges import AgeJudge, Judge, Judgement, RateJudge
from dyknow.manager.graph import Graph
from dyknow.manager.host import Host
from dyknow.manager.record import Record
from dyknow.model.streams import NO_MESSAGE, UNKNOWN_AGE, ClaimState
from dyknow.model.transformation import Transformation

#: Seconds between two counts.
_PERIOD = 0.5
#: Windows for which a part has to keep its limit before it is trusted again.
_WINDOWS = 2
#: Seconds of the first pause of a transformation that failed: longer than a round of the
#: reconciler, so that another way is tried in between.
_FIRST_PAUSE_OF_ALL = 1.0
#: Seconds of the first and of the longest pause of a transformation, for one claim. The first is
#: longer than it takes to judge another one.
_FIRST_PAUSE = 15.0
_LONGEST_PAUSE = 600.0
#: Seconds of a stream that was fast enough after which earlier failures are forgiven.
_FORGIVEN_AFTER = 60.0

_log = logging.getLogger("rosout.dyknow")
#: Seconds that a part may take to send its first message, if the claim does not allow more.
FIRST_MESSAGE = 2.0
#: Seconds between two counts while a first message is awaited.
_FIRST_MESSAGE_PERIOD = 0.25
#: Counts in the time for which a part may be silent, and the least seconds between two.
_COUNTS = 4
_LEAST_PERIOD = 0.05


@dataclass
class _Shortfall:
    """A part that does not keep a claim's limit, and since when it keeps it again."""

    judge: Judge
    judgement: Judgement
    good_since: Optional[float] = None


class QualityMonitor:
    """Judges the streams of claims that demand a rate or an age."""

    def __init__(
        self,
        meter: FlowMeter,
        graph: Graph,
        clock: Callable[[], float],
        topics: Callable[[], Iterable[Transformation]] = tuple,
    ) -> None:
        self._meter = meter
        self._graph = graph
        self._clock = clock
        self._topics = topics
        self._ages = AgeJudge(self._stated_latency)
        self._judges: Tuple[Judge, ...] = (RateJudge(), self._ages)
        self._shortfalls: Dict[str, Dict[str, _Shortfall]] = {}
        self._failures = Backoff(clock, _FIRST_PAUSE, _LONGEST_PAUSE, _FORGIVEN_AFTER)

    def periods(self, claims: Iterable[Claim]) -> Dict[Place, float]:
        """Seconds between two counts, by place."""
        claims = list(claims)
        places = {place for judge in self._judges for place in self._windows(judge, claims)}
        return dict.fromkeys(places, _PERIOD)

    def judge(self, claims: Iterable[Claim]) -> None:
        """Judge by the latest counts."""
        claims, now = [each for each in claims if each.topic and self._limits(each)], self._clock()
        self._forget({claim.claim_id for claim in claims})
        for judge in self._judges:
            judge.add(self._meter.counted, self._windows(judge, claims))
        for claim in claims:
            self._forgive(claim.claim_id)
            parts = self._meter.parts(claim)
            for judge in self._limits(claim):
                judgement = judge.judge(parts, now)
                if judgement is not None:
                    self._add_shortfall(claim, judge, judgement)

    def restart(self, claim_id: str, rewired: Iterable[str]) -> None:
        """Start again with nodelets that were connected elsewhere for a claim."""
        rewired = set(rewired)
        for judge in self._judges:
            judge.restart(claim_id, rewired, self._clock())

    def is_age_unknown(self, claim: Claim) -> bool:
        """Whether messages of a claim's stream have come whose age is unknown."""
        return self._ages.is_unknown(goal_of(claim))

    def faults(self, claim: Claim) -> List[str]:
        """Say which parts keep a claim's stream from its limits."""
        parts = {*claim.nodelets, *claim.sources}
        return [
            each.judgement.what
            for name, each in sorted(self._shortfalls.get(claim.claim_id, {}).items())
            if name in parts
        ]

    def unfit(self, claims: Iterable[Claim]) -> FrozenSet[str]:
        """Nodelets and topics that deliver too little for one of these claims."""
        return frozenset(
            name for claim in claims for name in self._shortfalls.get(claim.claim_id, ())
        )

    def paused(self, claims: Iterable[Claim]) -> FrozenSet[str]:
        """Labels of which no nodelet is to be made for these claims, for a while."""
        ids = {claim.claim_id for claim in claims}
        found = [key.split(" ", 1) for key in self._failures.paused]
        return frozenset(label for claim_id, label in found if claim_id in ids)

    @property
    def signature(self) -> Hashable:
        """A value that differs when a plan may have become possible."""
        shortfalls = frozenset((key, *sorted(each)) for key, each in self._shortfalls.items())
        return shortfalls, self._failures.paused

    # Inside

    def _limits(self, claim: Claim) -> List[Judge]:
        return [judge for judge in self._judges if judge.limit(claim) > 0]

    def _windows(self, judge: Judge, claims: Iterable[Claim]) -> Dict[Place, float]:
        """Seconds over which places are judged."""
        found: Dict[Place, float] = {}
        for claim in claims:
            if claim.topic and judge.limit(claim) > 0:
                window = judge.window(judge.limit(claim))
                for place in self._meter.parts(claim).topics:
                    found[place] = max(found.get(place, window), window)
        for shortfalls in self._shortfalls.values():
            for each in shortfalls.values():
                if each.judge is judge:
                    place, window = each.judgement.place, judge.window(each.judgement.needed)
                    found[place] = max(found.get(place, window), window)
        return found

    def _stated_latency(self, place: Place) -> float:
        """Seconds that a place states to add to the age of messages; 0 if it states none."""
        name, port = place
        record = self._graph.find(name)
        if name:
            found = [] if record is None else [record.transformation]
        else:
            found = [each for each in self._topics() if each.source == port]
        ports = [each for one in found if one is not None for each in one.ports]
        return max((each.latency for each in ports if not name or each.name == port), default=0.0)

    def _add_shortfall(self, claim: Claim, judge: Judge, judgement: Judgement) -> None:
        name = name_of(judgement.place)
        shortfalls = self._shortfalls.setdefault(claim.claim_id, {})
        if name in shortfalls:
            return
        shortfalls[name] = _Shortfall(judge, judgement)
        _log.warning("claim %s: %s", claim.claim_id, judgement.what)
        record = self._graph.find(name)
        if record is not None:
            key = f"{claim.claim_id} {record.label}"
            self._failures.served(key, judge.served(claim.claim_id))
            self._failures.failed(key)

    def _forgive(self, claim_id: str) -> None:
        """Trust the parts again that have delivered enough for long enough."""
        now = self._clock()
        shortfalls = self._shortfalls.get(claim_id, {})
        for name, each in list(shortfalls.items()):
            place, needed, _ = each.judgement
            if each.judge.falls_short(place, needed) is not False:
                each.good_since = None
            elif each.good_since is None:
                each.good_since = now
            elif now - each.good_since >= (_WINDOWS - 1) * each.judge.window(needed):
                del shortfalls[name]

    def _forget(self, claim_ids: Set[str]) -> None:
        """Forget claims that have ended, and nodelets that are gone."""
        for judge in self._judges:
            judge.keep(claim_ids)
        self._shortfalls = {
            key: {
                name: each
                for name, each in found.items()
                if not each.judgement.place[0] or self._graph.find(name) is not None
            }
            for key, found in self._shortfalls.items()
            if key in claim_ids
        }


class StreamMonitor:
    """Watches the messages of all streams."""

    def __init__(
        self,
        host: Host,
        graph: Graph,
        table: ClaimTable,
        topics: Callable[[], Iterable[Transformation]],
        clock: Callable[[], float],
        running: Callable[[], float],
    ) -> None:
        self._table = table
        self._meter = FlowMeter(host, graph, clock, running)
        self._silence = SilenceMonitor(self._meter, graph)
        self._first_messages = FirstMessageMonitor(table, self._meter, graph, clock)
        #: Which claims get less than they demand, and because of which parts.
        self.quality = QualityMonitor(self._meter, graph, clock, topics)

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
        """Silent and unresponsive parts."""
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

    def report(self) -> None:
        """Change the claims whose first message has come, or whose messages' age is unknown."""
        self._first_messages.report()
        for claim in self._table.living():
            if claim.request.max_age and claim.state is ClaimState.ACTIVE:
                is_unknown = self.quality.is_age_unknown(claim)
                if is_unknown and not claim.detail:
                    self._table.change(claim.claim_id, UNKNOWN_AGE, detail=UNKNOWN_AGE)
                elif claim.detail == UNKNOWN_AGE and not is_unknown:
                    reason = "it is known how old its messages are"
                    self._table.change(claim.claim_id, reason, detail="")


class Failures:
    """Transformations that failed lately: nothing is made of them for a while."""

    def __init__(self, graph: Graph, monitor: StreamMonitor, clock: Callable[[], float]) -> None:
        self._graph = graph
        self._monitor = monitor
        self._backoff = Backoff(clock, _FIRST_PAUSE_OF_ALL)

    @property
    def paused(self) -> FrozenSet[str]:
        """Labels of which nothing is to be made now."""
        return self._backoff.paused

    def failed(self, label: str) -> None:
        """Count a nodelet that could not be made, or whose code crashed after its end."""
        self._backoff.failed(label)

    def fell(self, record: Record) -> None:
        """Count a nodelet's death, or silence, against its transformation."""
        lifetime = self._graph.lifetime(record.name)
        self._backoff.served(record.label, lifetime)
        self._backoff.failed(record.label, self._monitor.service(record.name, lifetime))


class SilenceMonitor:
    """Finds parts of streams that have fallen silent, where a claim has a ``max_silence``.

    A part counts as silent only if its suppliers have sent something since its own last message:
    of a silent chain the first part, and none as long as a count from further up is due. The same
    counts lead to the same judgement at any time.
    """

    def __init__(self, meter: FlowMeter, graph: Graph) -> None:
        self._meter = meter
        self._graph = graph
        #: Silent nodelets and topics, each with a sentence about it.
        self.silent: Dict[str, str] = {}

    def periods(self, claims: Iterable[Claim]) -> Dict[Place, float]:
        """Seconds between two counts, by place."""
        found: Dict[Place, float] = {}
        for claim in _watched(claims):
            period = max(claim.request.max_silence / _COUNTS, _LEAST_PERIOD)
            for place in self._meter.parts(claim).topics:
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
            fallen.update(self._judge(self._meter.parts(claim)))
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
            for senders in parts.suppliers(place)
        )


class FirstMessageMonitor:
    """Keeps ``NO_MESSAGE`` in the detail of a claim until the first message of its stream.

    A stream can be wired as it should be and yet carry no messages, so each change of a stream
    raises the question again. Counts that nodelets keep anyway answer it. DyKnow does not
    subscribe to a topic merely to find out: where the publisher cannot be polled, the claim says
    so.
    """

    def __init__(
        self, table: ClaimTable, meter: FlowMeter, graph: Graph, clock: Callable[[], float]
    ) -> None:
        self._table = table
        self._meter = meter
        self._graph = graph
        self._clock = clock
        self._since: Dict[str, float] = {}

    def expect(self, claim: Claim, goal: Place, topic: str) -> str:
        """Start to wait, now that a claim's stream was changed; returns the claim's detail."""
        self._since[claim.claim_id] = self._clock()
        record = self._graph.find(goal[0])
        can_be_asked = record is not None and not record.is_fixed
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
