# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The health of streams: silent, late, slow and unresponsive parts, and failed transformations."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Callable, Hashable, Iterable

from dyknow.backoff import Backoff
from dyknow.manager.claim import Claim
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.flows import FlowMeter, Place, StreamParts, described, goal_of, name_of
from dyknow.manager.claims.judges import AgeJudge, Judge, Judgement, RateJudge
from dyknow.manager.graph import Graph
from dyknow.manager.host import Host
from dyknow.manager.record import Record
from dyknow.model.graph import State
from dyknow.model.streams import NO_MESSAGE, UNKNOWN_AGE, ClaimState
from dyknow.model.transformation import Transformation

#: Seconds that a part may take to send its first message, if the claim does not allow more.
FIRST_MESSAGE = 2.0
#: Seconds between two counts where a limit is judged, and while a first message is awaited.
_PERIOD = 0.5
_FIRST_MESSAGE_PERIOD = 0.25
#: Counts in the time for which a part may be silent, and the least seconds between two.
_COUNTS = 4
_LEAST_PERIOD = 0.05
#: Windows for which a part has to keep its limit before it is trusted again.
_WINDOWS = 2
#: Seconds of the first pause of a transformation that failed: longer than a round of the
#: reconciler, so that another way is tried in between.
_FIRST_PAUSE_OF_ALL = 1.0
#: Seconds of the first and of the longest pause of a transformation, for one claim. The first is
#: longer than it takes to judge another one.
_FIRST_PAUSE = 15.0
_LONGEST_PAUSE = 600.0
#: Seconds of a stream that kept its limits after which earlier failures are forgiven.
_FORGIVEN_AFTER = 60.0

_log = logging.getLogger("rosout.dyknow")


@dataclass
class _Shortfall:
    """A part that does not keep a claim's limit, and since when it keeps it again."""

    judge: Judge
    judgement: Judgement
    good_since: float | None = None


class QualityMonitor:
    """Judges the streams of claims that demand a rate or an age."""

    def __init__(
        self,
        meter: FlowMeter,
        graph: Graph,
        clock: Callable[[], float],
        topics: Callable[[], Iterable[Transformation]],
    ) -> None:
        self._meter = meter
        self._graph = graph
        self._clock = clock
        self._topics = topics
        self._ages = AgeJudge(lambda: meter.flows, self._stated_latency)
        self._judges: tuple[Judge, ...] = (RateJudge(lambda: meter.flows), self._ages)
        self._shortfalls: dict[str, dict[str, _Shortfall]] = {}
        self._failures = Backoff(clock, _FIRST_PAUSE, _LONGEST_PAUSE, _FORGIVEN_AFTER)

    def windows(self, claims: Iterable[Claim]) -> dict[Place, float]:
        """Seconds over which places are judged."""
        judged = [
            (place, judge.window(judge.limit(claim)))
            for claim in claims
            if claim.topic
            for judge in self._limits(claim)
            for place in self._meter.parts(claim).topics
        ]
        judged += [
            (each.judgement.place, each.judge.window(each.judgement.needed))
            for shortfalls in self._shortfalls.values()
            for each in shortfalls.values()
        ]
        found: dict[Place, float] = {}
        for place, window in judged:
            found[place] = max(found.get(place, window), window)
        return found

    def judge(self, claims: Iterable[Claim]) -> None:
        """Judge by the latest counts."""
        claims = [each for each in claims if each.topic and self._limits(each)]
        self._forget({claim.claim_id for claim in claims})
        for claim in claims:
            self._forgive(claim.claim_id)
            parts = self._meter.parts(claim)
            for judge in self._limits(claim):
                judgement = judge.judge(parts, self._clock())
                if judgement is not None:
                    self._add_shortfall(claim, judge, judgement)

    def restart(self, claim_id: str) -> None:
        """Start again with a claim whose nodelets were connected elsewhere."""
        for judge in self._judges:
            judge.restart(claim_id, self._clock())

    def is_age_unknown(self, claim: Claim) -> bool:
        """Whether messages of a claim's stream have come whose age is unknown."""
        return self._ages.is_unknown(goal_of(claim))

    def faults(self, claim: Claim) -> list[str]:
        """Say which parts keep a claim's stream from its limits."""
        shortfalls = self._shortfalls.get(claim.claim_id, {})
        parts = sorted(shortfalls.keys() & {*claim.nodelets, *claim.sources})
        return [shortfalls[name].judgement.what for name in parts]

    def unfit(self, claims: Iterable[Claim]) -> frozenset[str]:
        """Nodelets and topics that deliver too little for one of these claims."""
        return frozenset(
            name for claim in claims for name in self._shortfalls.get(claim.claim_id, ())
        )

    def paused(self, claims: Iterable[Claim]) -> frozenset[str]:
        """Labels of which no nodelet is to be made for these claims, for a while."""
        ids = {claim.claim_id for claim in claims}
        found = [key.split(" ", 1) for key in self._failures.paused]
        return frozenset(label for claim_id, label in found if claim_id in ids)

    @property
    def signature(self) -> Hashable:
        """A value that differs when a plan may have become possible."""
        shortfalls = frozenset((key, *sorted(each)) for key, each in self._shortfalls.items())
        return shortfalls, self._failures.paused

    def _limits(self, claim: Claim) -> list[Judge]:
        return [judge for judge in self._judges if judge.limit(claim) > 0]

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
            self._failures.served(key, judge.history(claim.claim_id).served)
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

    def _forget(self, claim_ids: set[str]) -> None:
        """Forget all other claims, and nodelets that are gone."""
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
    """Watches the messages of all streams, and remembers which transformations failed.

    A part counts as silent only if its suppliers have sent something since its own last message:
    of a silent chain the first part, and none as long as a count from further up is due.

    A stream can be wired as it should be and yet carry no messages, so each change of a stream
    puts ``NO_MESSAGE`` into the detail of its claim until a message has come. Counts that nodelets
    keep anyway show that. DyKnow does not subscribe to a topic merely to find out.
    """

    def __init__(
        self,
        host: Host,
        graph: Graph,
        table: ClaimTable,
        topics: Callable[[], Iterable[Transformation]],
        clock: Callable[[], float],
        running: Callable[[], float],
    ) -> None:
        self._graph = graph
        self._table = table
        self._clock = clock
        self._meter = FlowMeter(host, graph, clock, running)
        self._failures = Backoff(clock, _FIRST_PAUSE_OF_ALL)
        #: When the stream of a claim was changed last.
        self._changed: dict[str, float] = {}
        #: Silent nodelets and topics, each with a sentence about it.
        self.silent: dict[str, str] = {}
        #: Which claims get less than they demand, and because of which parts.
        self.quality = QualityMonitor(self._meter, graph, clock, topics)

    @property
    def unresponsive(self) -> frozenset[str]:
        """Nodelets that do not answer."""
        return self._meter.unresponsive

    def is_reachable(self, record: Record) -> bool:
        """Whether the ports of a nodelet can be connected elsewhere now."""
        is_movable = record.state is State.RUNNING and not record.is_fixed
        return is_movable and record.name not in self.unresponsive

    @property
    def unhealthy(self) -> frozenset[str]:
        """Silent and unresponsive parts."""
        return self.unresponsive | frozenset(self.silent)

    def read(self) -> None:
        """Count messages, and judge the streams by them."""
        claims = self._table.living
        watched = [each for each in claims if each.request.max_silence > 0 and each.topic]
        windows = self.quality.windows(claims)
        steady = dict.fromkeys(windows, _PERIOD)
        for place, period in self._silence_periods(watched):
            steady[place] = min(steady.get(place, period), period)
        awaited = {goal_of(claim): _FIRST_MESSAGE_PERIOD for claim in claims if _waits(claim)}
        came = self._meter.read(awaited, steady, windows)
        self.quality.judge(claims)
        counted = set(map(name_of, self._meter.flows)) - set(map(name_of, came))
        self.silent = {name: why for name, why in self.silent.items() if name in counted}
        fallen: set[str] = set()
        for claim in watched:
            fallen.update(self._judge_silence(self._meter.parts(claim)))
        for name in sorted(fallen):
            _log.warning("%s", self.silent[name])
            record = self._graph.find(name)
            if record is not None:
                self.fell(record)

    def restart(self, claim: Claim, rewired: Iterable[str] = ()) -> str:
        """Restart with a claim's stream that was changed just now; returns the claim's detail.

        ``rewired`` are its nodelets that were connected elsewhere.
        """
        rewired = set(rewired)
        self._meter.restart(rewired)
        if rewired:
            self.quality.restart(claim.claim_id)
        self._changed[claim.claim_id] = self._clock()
        record, request = self._graph.find(claim.goal[0]), claim.request
        is_listened_to = any((request.max_silence, request.min_rate, request.max_age))
        if is_listened_to or (record is not None and not record.is_fixed):
            return NO_MESSAGE
        return f"not known whether messages come: the publisher of {claim.topic} cannot be asked"

    def report(self) -> None:
        """Change the claims whose first message has come, or whose messages' age is unknown."""
        claims, now = self._table.living, self._clock()
        self._changed = {each.claim_id: self._changed.get(each.claim_id, now) for each in claims}
        for claim in claims:
            is_active = claim.state is ClaimState.ACTIVE
            is_unknown = bool(claim.request.max_age) and self.quality.is_age_unknown(claim)
            detail = claim.detail
            if _waits(claim):
                flow = self._meter.flows.get(goal_of(claim))
                since = self._changed[claim.claim_id]
                if flow is not None and (flow.last.latched or flow.came_after >= since):
                    reason, detail = "its first message has come", ""
                    self._table.change(claim.claim_id, reason, detail="")
            if is_active and is_unknown and not detail:
                self._table.change(claim.claim_id, UNKNOWN_AGE, detail=UNKNOWN_AGE)
            elif is_active and detail == UNKNOWN_AGE and not is_unknown:
                reason = "it is known how old its messages are"
                self._table.change(claim.claim_id, reason, detail="")

    # Transformations that failed lately: nothing is made of them for a while

    @property
    def paused(self) -> frozenset[str]:
        """Labels of which nothing is to be made now."""
        return self._failures.paused

    def failed(self, label: str) -> None:
        """Count a nodelet that could not be made, or whose code crashed after its end."""
        self._failures.failed(label)

    def fell(self, record: Record) -> None:
        """Count a nodelet's death, or silence, against its transformation."""
        lifetime = self._graph.lifetime(record.name)
        flows = [
            flow for (name, _), flow in list(self._meter.flows.items()) if name == record.name
        ]
        silences = [flow.silence if flow.begun else lifetime for flow in flows]
        self._failures.served(record.label, lifetime)
        self._failures.failed(record.label, max(0.0, lifetime - max(silences, default=0.0)))

    # Silence

    def _silence_periods(self, watched: Iterable[Claim]) -> list[tuple[Place, float]]:
        """Seconds between two counts where silence is judged."""
        found = [
            (place, max(claim.request.max_silence / _COUNTS, _LEAST_PERIOD))
            for claim in watched
            for place in self._meter.parts(claim).topics
        ]
        known = {place for place, _ in found}
        found += [  # silent parts that no claim uses any more are watched until they are gone
            (place, FIRST_MESSAGE / _COUNTS)
            for place in self._meter.flows
            if place not in known and place[0] in self.silent and self._graph.find(place[0])
        ]
        return found

    def _judge_silence(self, parts: StreamParts) -> set[str]:
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


def _waits(claim: Claim) -> bool:
    return claim.state is ClaimState.ACTIVE and claim.detail == NO_MESSAGE
