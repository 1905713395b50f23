# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The health of streams: judgements of their parts, and first messages.

There is one table of judgements. Each limit adds to it the parts that keep a stream from the
limit. A judgement stands until the part keeps the limit again; meanwhile plans leave the part out,
and repairs replace it. Deaths and judgements count against transformations, of which nothing is
made for a while.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import AbstractSet, Callable, Collection, Hashable, Iterable

from dyknow.backoff import Backoff
from dyknow.manager.claim import Claim
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.flows import WINDOW, FlowMeter, Place, Stream, Watch
from dyknow.manager.claims.limits import (
    COUNTS,
    FIRST_MESSAGE,
    Age,
    Judgement,
    Limit,
    Rate,
    Silence,
)
from dyknow.manager.claims.requirements import Requirements
from dyknow.manager.claims.world import World
from dyknow.manager.record import Record
from dyknow.manager.supervision.lifecycle import ManagerContext
from dyknow.model.graph import State
from dyknow.model.streams import NO_MESSAGE, UNKNOWN_AGE, ClaimState

#: Seconds between two counts while a first message is awaited.
_FIRST_MESSAGE_PERIOD = 0.25
#: Seconds of the first pause of a transformation that failed: longer than a round of the
#: reconciler, so that another way is tried in between.
_FIRST_PAUSE_OF_ALL = 1.0
#: Seconds of the first and of the longest pause of a transformation, for one claim. The first is
#: longer than it takes to judge another one.
_FIRST_PAUSE = 15.0
_LONGEST_PAUSE = 600.0
#: Seconds of a stream that kept its limits after which earlier failures are forgiven.
_FORGIVEN_AFTER = 60.0
#: In the place of a claim's id, for judgements that concern all claims.
_ALL = ""

_log = logging.getLogger("rosout.dyknow")


@dataclass
class _Shortfall:
    """A part that does not keep a limit, and since when it keeps it again."""

    limit: Limit
    judgement: Judgement
    good_since: float | None = None


class StreamMonitor:
    """Watches the messages of all streams, and remembers which transformations failed.

    A stream can be wired as it should be and yet carry no messages, so each change of a stream
    puts ``NO_MESSAGE`` into the detail of its claim until a message has come. Counts that nodelets
    keep anyway show that. DyKnow does not subscribe to a topic merely to find out.
    """

    def __init__(
        self,
        context: ManagerContext,
        table: ClaimTable,
        world: Callable[[], World],
        running: Callable[[], float],
        recover: float,
    ) -> None:
        """Watch nothing yet; ``running`` is that of the table, ``recover`` of requirements."""
        clock = context.clock.now
        self._graph = context.graph
        self._library = context.library
        self._table = table
        self._world = world
        self._clock = clock
        self._meter = FlowMeter(context.host, context.graph, clock, running)
        self.requirements = Requirements(context, table, world, recover)
        #: Every limit that a claim may set.
        self._limits: tuple[Limit, ...] = (Silence(), Rate(), Age(self._stated_latency))
        #: The table of judgements: parts by name, by the claim that they are of no use to.
        self._shortfalls: dict[str, dict[str, _Shortfall]] = {}
        self._streams: dict[str, Stream] = {}
        self._failures = Backoff(clock, _FIRST_PAUSE_OF_ALL)
        self._failures_for_claims = Backoff(clock, _FIRST_PAUSE, _LONGEST_PAUSE, _FORGIVEN_AFTER)
        #: Transformations that are left out of streams of which the formula was FALSE, and the
        #: parts that were made of them, by claim.
        self._violations = Backoff(clock, _FIRST_PAUSE, _LONGEST_PAUSE, _FORGIVEN_AFTER, 0)
        self._blamed: dict[str, dict[str, str]] = {}
        self._backoffs = (self._failures, self._failures_for_claims, self._violations)

    # The parts that can be relied on

    def is_reachable(self, record: Record) -> bool:
        """Whether the ports of a nodelet can be connected elsewhere now."""
        is_movable = record.state is State.RUNNING and not record.is_fixed
        return is_movable and record.name not in self._meter.unresponsive

    def unfit(self, claims: Iterable[Claim] = (), by_verdicts: bool = True) -> dict[str, str]:
        """Say why no claim, or none of these claims, can rely on nodelets and topics.

        Parts that are only not available by the verdicts that they require can be left out.
        """
        claims = list(claims)
        found = {name: f"nodelet {name} does not answer" for name in self._meter.unresponsive}
        if by_verdicts:
            found.update(self.requirements.unavailable)
        if by_verdicts and self._library.guarded:
            found.update(self.requirements.untried())
        for key in (_ALL, *[claim.claim_id for claim in claims]):
            for name, each in self._shortfalls.get(key, {}).items():
                found[name] = each.judgement.what
        for claim in claims:
            for name in self.blamed(claim):
                found[name] = f"'{claim.request.require}' was FALSE with {name}"
        return found

    def faults(self, claim: Claim) -> list[str]:
        """Say which parts of a claim's stream cannot be relied on."""
        parts = (*claim.nodelets, *claim.sources)
        found = [
            self._shortfalls[key][name].judgement.what
            for name in parts
            for key in (_ALL, claim.claim_id)
            if name in self._shortfalls.get(key, ())
        ]
        hanging = self._meter.unresponsive.intersection(claim.nodelets)
        found += [f"nodelet {name} does not answer" for name in sorted(hanging)]
        unavailable = self.requirements.unavailable
        found += [unavailable[name] for name in parts if name in unavailable]
        violation = self.violation(claim)
        return [*found, violation] if violation else found

    @property
    def signature(self) -> Hashable:
        """A value that differs when a plan may have become possible."""
        shortfalls = frozenset((key, *sorted(each)) for key, each in self._shortfalls.items())
        paused = tuple([each.paused for each in self._backoffs])
        return shortfalls, self._meter.unresponsive, paused, self.requirements.verdicts

    # Transformations that failed lately: nothing is made of them for a while

    def paused(self, claims: Iterable[Claim]) -> frozenset[str]:
        """Labels of which no nodelet is to be made for these claims now."""
        theirs = tuple([f"{claim.claim_id} " for claim in claims])
        keys = self._failures_for_claims.paused | self._violations.paused
        labels = [key.split(" ", 1)[1] for key in keys if key.startswith(theirs)]
        return self._failures.paused.union(labels)

    @property
    def pause_ends(self) -> float:
        """Seconds until the next transformation may be used again; infinite if none is paused."""
        return min(each.soonest for each in self._backoffs)

    def failed(self, label: str) -> None:
        """Count a nodelet that could not be made, or whose code crashed after its end."""
        self._failures.failed(label)

    def forgive(self, label: str) -> None:
        """Forget the failures of a transformation, which was replaced."""
        self._failures.forgive(label)
        for claim in self._table.living:
            for each in (self._failures_for_claims, self._violations):
                each.forgive(f"{claim.claim_id} {label}")

    def fell(self, record: Record, cause: str = "") -> None:
        """Count a nodelet's death, or silence, against its transformation, once for a cause."""
        lifetime = self._graph.lifetime(record.name)
        flows = [flow for (name, _), flow in [*self._meter.flows.items()] if name == record.name]
        silences = [flow.silence if flow.begun else lifetime for flow in flows]
        self._failures.served(record.label, lifetime)
        served = max(0.0, lifetime - max(silences, default=0.0))
        self._failures.failed(record.label, served, cause)

    # Judging

    def read(self, held: Collection[str] = ()) -> None:
        """Count messages, hear verdicts, and judge the streams but those of claims ``held``."""
        self.requirements.read()
        limited = [
            (limit, self._stream(claim))
            for claim in self._table.living
            for limit in self._limits
            if claim.topic and limit.of(claim) > 0
        ]
        self._meter.read(self._watched(limited))
        self._forgive({stream.claim.claim_id for _, stream in limited})
        for limit, stream in limited:
            if stream.claim.claim_id in held:
                continue
            for judgement in limit.judge(stream, self._meter.flows, self._clock()):
                self._add(limit, stream, judgement)

    def _stream(self, claim: Claim) -> Stream:
        known = self._streams.get(claim.claim_id)
        if known is None:
            known = self._streams[claim.claim_id] = Stream(claim, self._clock())
        return known.follow(claim, self._graph)

    def _watched(self, limited: Collection[tuple[Limit, Stream]]) -> dict[Place, Watch]:
        """Return how each place is counted."""
        wanted = [
            (place, limit.watch(limit.of(stream.claim)))
            for limit, stream in limited
            for place in stream.topics
        ]
        # Nodelets that no claim uses any more are watched until they are gone, topics while
        # there are limits.
        wanted += [
            (place, each.limit.watch(needed) if key else Watch(FIRST_MESSAGE / COUNTS, WINDOW))
            for key, shortfalls in self._shortfalls.items()
            for each in shortfalls.values()
            for place, needed, _ in [each.judgement]
            if place[0] or limited
        ]
        wanted += [
            (self._stream(claim).goal, Watch(_FIRST_MESSAGE_PERIOD))
            for claim in self._table.living
            if _waits(claim)
        ]
        found: dict[Place, Watch] = {}
        for place, watch in wanted:
            found[place] = watch.merged(found.get(place))
        return found

    def _add(self, limit: Limit, stream: Stream, judgement: Judgement) -> None:
        claim_id = stream.claim.claim_id
        name = judgement.place[0] or judgement.place[1]  # a nodelet's, or a topic's
        shortfalls = self._shortfalls.setdefault(_ALL if limit.concerns_all else claim_id, {})
        if name in shortfalls:
            return
        shortfalls[name] = _Shortfall(limit, judgement)
        record = self._graph.find(name)
        if limit.concerns_all:
            _log.warning("%s", judgement.what)
            if record is not None:
                self.fell(record)
            return
        _log.warning("claim %s: %s", claim_id, judgement.what)
        if record is not None:
            key = f"{claim_id} {record.label}"
            self._failures_for_claims.served(key, stream.served(limit.name))
            self._failures_for_claims.failed(key)

    def _forgive(self, claim_ids: set[str]) -> None:
        """Trust parts again that have kept their limits for long enough; forget those gone."""
        self._shortfalls = {
            key: {name: each for name, each in found.items() if not self._is_over(each)}
            for key, found in self._shortfalls.items()
            if key == _ALL or key in claim_ids
        }

    def _is_over(self, shortfall: _Shortfall) -> bool:
        now, limit, (place, needed, _) = self._clock(), shortfall.limit, shortfall.judgement
        if place[0] and self._graph.find(place[0]) is None:
            return True
        if limit.falls_short(self._meter.flows.get(place), needed) is not False:
            shortfall.good_since = None
            return False
        if shortfall.good_since is None:
            shortfall.good_since = now
        return now - shortfall.good_since >= limit.probation * limit.watch(needed).window

    # Formulas of requests

    def violation(self, claim: Claim) -> str:
        """Say that the formula of a claim's request is FALSE of its stream; empty if it is not."""
        return self.requirements.violation(claim, self._stream(claim).changed)

    def blamed(self, claim: Claim) -> set[str]:
        """Parts that are left out of a claim's stream for a while, since its formula was FALSE."""
        found = self._blamed.get(claim.claim_id)
        if not found:
            return set()
        paused = self._violations.paused
        return {part for part, key in found.items() if key in paused}

    def blame(self, claim: Claim, part: str, label: str) -> None:
        """Leave a part out of a claim's stream, and its transformation, for a while."""
        key = f"{claim.claim_id} {label}"
        _log.warning("claim %s: it goes on without %s", claim.claim_id, part)
        self._violations.served(key, self._clock() - self._stream(claim).changed)
        self._violations.failed(key)
        self._blamed.setdefault(claim.claim_id, {})[part] = key

    def _stated_latency(self, place: Place) -> float:
        """Seconds that a place states to add to the age of messages; 0 if it states none."""
        name, port = place
        record = self._graph.find(name)
        if name:
            found = [] if record is None else [record.transformation]
        else:
            found = [each for each in self._world().descriptions if each.source == port]
        ports = [each for one in found if one is not None for each in one.ports]
        return max((each.latency for each in ports if not name or each.name == port), default=0.0)

    # The first message

    def restart(self, claim: Claim, rewired: AbstractSet[str] | None = None) -> str:
        """Restart with a claim's stream that was changed just now; returns the claim's detail.

        ``rewired`` are the nodelets that were connected elsewhere, if it was made again.
        """
        now = self._clock()
        stream = self._streams.setdefault(claim.claim_id, Stream(claim, now))
        stream.changed = now
        if rewired is not None:
            is_all = rewired >= claim.wiring.keys()
            self._meter.restart(
                rewired if is_all else stream.follow(claim, self._graph).fed_by(rewired)
            )
            stream.connected(now)
        record, request = self._graph.find(claim.goal[0]), claim.request
        is_listened_to = any((request.max_silence, request.min_rate, request.max_age))
        if is_listened_to or (record is not None and not record.is_fixed):
            return NO_MESSAGE
        return f"not known whether messages come: the publisher of {claim.topic} cannot be queried"

    def report(self) -> None:
        """Change the claims whose first message has come, or whose messages' age is unknown."""
        living = {claim.claim_id for claim in self._table.living}
        self._streams = {key: each for key, each in self._streams.items() if key in living}
        self._blamed = {key: each for key, each in self._blamed.items() if key in living}
        for claim in self._table.living:
            stream = self._stream(claim)
            flow = self._meter.flows.get(stream.goal)
            is_active = claim.state is ClaimState.ACTIVE
            is_unknown = claim.request.max_age > 0 and flow is not None and flow.is_age_unknown
            detail = claim.detail
            has_come = flow is not None and (
                flow.last.latched or flow.came_after >= stream.changed
            )
            if _waits(claim) and has_come:
                detail = ""
                self._table.change(claim.claim_id, "its first message has come", detail="")
            if is_active and is_unknown and not detail:
                self._table.change(claim.claim_id, UNKNOWN_AGE, detail=UNKNOWN_AGE)
            elif is_active and detail == UNKNOWN_AGE and not is_unknown:
                reason = "it is known how old its messages are"
                self._table.change(claim.claim_id, reason, detail="")


def _waits(claim: Claim) -> bool:
    return claim.state is ClaimState.ACTIVE and claim.detail == NO_MESSAGE
