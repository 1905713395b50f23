"""Notices parts of streams that have fallen silent, where a claim wants to know.

Only parts of claims with a ``max_silence`` are watched; they are counted four times in that time.
Who sends nothing is to blame only if what feeds it has sent something since: of a chain that is
silent that is the first part, and it is nobody as long as an answer from further up is due.
"""

from __future__ import annotations

from typing import Dict, FrozenSet, Iterable, List, Mapping, Set

from dyknow.manager.claim import Claim
from dyknow.manager.claims.flows import FlowMeter, Place
from dyknow.manager.graph import Graph
from dyknow.model.graph import State
from dyknow.model.transformation import OUT

#: Seconds that a part may take to send its first message, if the claim does not allow more.
FIRST_MESSAGE = 2.0
_LOOKS = 4
_LEAST_PERIOD = 0.05


class SilenceMonitor:
    """Judges by the counts; the same counts give the same judgement, whenever it is made."""

    def __init__(self, counts: FlowMeter, graph: Graph) -> None:
        """Watch nothing yet."""
        self._counts = counts
        self._graph = graph
        #: Nodelets and topics that are silent, and what to say about it.
        self.silent: Dict[str, str] = {}

    @property
    def unresponsive(self) -> FrozenSet[str]:
        """Nodelets that do not answer."""
        return self._counts.unresponsive

    @property
    def unhealthy(self) -> FrozenSet[str]:
        """Nodelets of which nothing is to be expected."""
        return self.unresponsive | frozenset(self.silent)

    def periods(self, claims: Iterable[Claim]) -> Dict[Place, float]:
        """Tell how often (s) to count where."""
        found: Dict[Place, float] = {}
        for claim in _watched(claims):
            period = max(claim.request.max_silence / _LOOKS, _LEAST_PERIOD)
            for place in self._places(claim):
                found[place] = min(found.get(place, period), period)
        for place in self._counts.flows:
            if place[0] in self.silent and self._graph.find(place[0]) is not None:
                found.setdefault(place, FIRST_MESSAGE / _LOOKS)
        return found

    def look(self, claims: Iterable[Claim], came: Iterable[Place]) -> List[str]:
        """Judge by the latest counts.

        Args:
            claims: those whose parts are watched, among others.
            came: places where messages have come since the last look.

        Returns:
            The nodelets and topics that have just fallen silent.
        """
        for place in came:
            self.silent.pop(_name(place), None)
        counted = set(map(_name, self._counts.flows))
        for name in [name for name in self.silent if name not in counted]:
            del self.silent[name]
        fallen: Set[str] = set()
        for claim in _watched(claims):
            fallen.update(self._judge(claim, self._places(claim)))
        return sorted(fallen)

    # Inside

    def _places(self, claim: Claim) -> Dict[Place, str]:
        """Out-ports and ordinary topics of a claim, with their topics."""
        places: Dict[Place, str] = {("", topic): topic for topic in claim.sources}
        for name in claim.nodelets:
            record = self._graph.find(name)
            if (
                record is None
                or record.transformation is None
                or record.state is not State.RUNNING
            ):
                continue
            outs = {port.name for port in record.transformation.ports if port.direction == OUT}
            for port, topic in claim.wiring[name].items():
                if port in outs:
                    places[(name, port)] = topic
        return places

    def _judge(self, claim: Claim, places: Mapping[Place, str]) -> Set[str]:
        limit = claim.request.max_silence
        fallen = set()
        for place in sorted(places):
            flow, name = self._counts.flows.get(place), _name(place)
            if flow is None or name in self.silent:
                continue
            allowed = limit if flow.begun else max(limit, FIRST_MESSAGE)
            if flow.silence > allowed and self._is_fed(place, claim, places):
                what = f"nodelet {name}" if name in claim.wiring else f"topic {name}"
                self.silent[name] = f"{what} was silent for longer than {limit:g} s"
                fallen.add(name)
        return fallen

    def _is_fed(self, place: Place, claim: Claim, places: Mapping[Place, str]) -> bool:
        """Whether all that feeds a place has sent something since its last message."""
        flows = self._counts.flows
        since = flows[place].quiet_from
        feeders: Dict[str, List[Place]] = {}
        for each, topic in places.items():
            if each[0] != place[0]:
                feeders.setdefault(topic, []).append(each)
        return all(
            any(each in flows and flows[each].came_after >= since for each in feeders[topic])
            for topic in claim.wiring.get(place[0], {}).values()
            if topic in feeders
        )


def _watched(claims: Iterable[Claim]) -> List[Claim]:
    return [each for each in claims if each.request.max_silence > 0 and each.topic]


def _name(place: Place) -> str:
    """Name of the nodelet, or of the topic where there is none."""
    return place[0] or place[1]
