# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which claims get less than they demand, and which parts of their streams are to blame.

A part is too slow, or too late, *for a claim*: others may go on with it. It stays so until it has
kept the limit for twice as long as it is judged over, so a part that is now above and now below
the limit makes nothing flap. Its transformation is given a second chance for the claim; after that
it is left for a while, longer each time.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Callable, Dict, FrozenSet, Hashable, Iterable, List, Optional, Set, Tuple

from dyknow.backoff import Backoff
from dyknow.manager.claim import Claim
from dyknow.manager.claims.ages import AgeJudge
from dyknow.manager.claims.flows import FlowMeter, Place
from dyknow.manager.claims.judges import Judge, Judgement
from dyknow.manager.claims.rates import RateJudge
from dyknow.manager.claims.stream_parts import StreamParts, goal_of, name_of
from dyknow.manager.graph import Graph
from dyknow.model.transformation import Transformation

#: Seconds between two counts.
_PERIOD = 0.5
#: Windows for which a part has to deliver what is demanded before it is trusted again.
_WINDOWS = 2
#: Seconds of the first and of the longest pause of a transformation, for one claim. The first is
#: longer than it takes to judge another one.
_FIRST_PAUSE = 15.0
_LONGEST_PAUSE = 600.0
#: Seconds of a stream that was fast enough after which earlier failures are forgiven.
_FORGIVEN_AFTER = 60.0

_log = logging.getLogger("rosout.dyknow")


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
        """Begin with no claim.

        Args:
            meter: the counts.
            graph: the nodelets.
            clock: steady time, in seconds.
            topics: returns what the library says about ordinary topics.
        """
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
            parts = StreamParts(claim, self._graph)
            for judge in self._limits(claim):
                judgement = judge.judge(parts, now)
                if judgement is not None:
                    self._blame(claim, judge, judgement)

    def restart(self, claim_id: str, rewired: Iterable[str]) -> None:
        """Begin again with nodelets that were connected elsewhere for a claim."""
        rewired = set(rewired)
        for judge in self._judges:
            judge.restart(claim_id, rewired, self._clock())

    def is_age_unknown(self, claim: Claim) -> bool:
        """Whether messages of a claim's stream have come, and nobody can tell how old they are."""
        return self._ages.is_unknown(goal_of(claim))

    def faults(self, claim: Claim) -> List[str]:
        """Say which parts of a claim's stream are to blame for what it lacks."""
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
                for place in StreamParts(claim, self._graph).topics:
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

    def _blame(self, claim: Claim, judge: Judge, judgement: Judgement) -> None:
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
