"""Notices parts of streams that have fallen silent, where a claim wants to know.

Nodelets are asked how many messages their out-ports have sent; topics of ordinary nodes and of
plain C++ nodelets are listened to. Only parts of claims with a ``max_silence`` are watched, four
times in that time. Of a chain that is silent the first part is to blame: the others have nothing
to send.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Dict, FrozenSet, Iterable, List, Mapping, Set, Tuple

from dyknow.errors import HostError, HostTimeout
from dyknow.manager.claim import Claim
from dyknow.manager.graph import Graph
from dyknow.manager.host import Host
from dyknow.manager.model import Record, State
from dyknow.manager.specifications.transformation import OUT

#: Seconds that a part may take to send its first message, if the claim does not allow more.
FIRST_MESSAGE = 2.0
_LOOKS = 4
_LEAST_PERIOD = 0.05

Place = Tuple[str, str]
"""A nodelet and its out-port; or no nodelet and a topic."""


@dataclass
class _Ear:
    count: int
    since: float
    begun: bool


class SilenceWatch:
    """Counts messages, and remembers since when there were none."""

    def __init__(self, host: Host, graph: Graph, clock: Callable[[], float]) -> None:
        """Watch nothing yet."""
        self._host = host
        self._graph = graph
        self._clock = clock
        self._ears: Dict[Place, _Ear] = {}
        self._due: Dict[str, float] = {}
        #: Nodelets and topics that are silent, and what to say about it.
        self.silent: Dict[str, str] = {}
        #: Nodelets that did not answer when they were asked last.
        self.mute: FrozenSet[str] = frozenset()

    @property
    def unhealthy(self) -> FrozenSet[str]:
        """Nodelets of which nothing is to be expected."""
        return self.mute | frozenset(self.silent)

    def look(self, claims: Iterable[Claim]) -> List[str]:
        """Count once more; returns the nodelets and topics that have just fallen silent."""
        watched = [each for each in claims if each.request.max_silence > 0 and each.topic]
        places = {claim.claim_id: self._places(claim) for claim in watched}
        limits: Dict[Place, float] = {}
        for claim in watched:
            for place in places[claim.claim_id]:
                limits[place] = min(limits.get(place, 1e9), claim.request.max_silence)
        known = {record.name: record for record in self._graph.all()}
        suspects = [place for place in self._ears if place[0] in self.silent and place[0] in known]
        for place in suspects:
            limits.setdefault(place, FIRST_MESSAGE)
        self._count(limits, known)
        for place in [place for place in self._ears if place not in limits]:
            del self._ears[place]
        self._forget(known)
        fallen: Set[str] = set()
        for claim in watched:
            fallen.update(self._judge(claim, places[claim.claim_id]))
        return sorted(fallen)

    def excuse(self, names: Iterable[str]) -> None:
        """Give nodelets that were re-wired just now their time from the beginning."""
        names = set(names)
        for (name, _), ear in self._ears.items():
            if name in names:
                ear.since = self._clock()

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

    def _count(self, limits: Mapping[Place, float], records: Mapping[str, Record]) -> None:
        now = self._clock()
        listened: Dict[str, List[Place]] = {}
        asked: Dict[str, List[Place]] = {}
        for place in sorted(limits):
            name, port = place
            record = records.get(name)
            if record is None:
                listened.setdefault(port, []).append(place)
            elif record.rewired_by_reload:
                listened.setdefault(record.topics.get(port, ""), []).append(place)
            else:
                asked.setdefault(name, []).append(place)
        if listened or any(not name for name, _ in self._ears):
            heard = self._host.heard(topic for topic in sorted(listened) if topic)
            for topic, places in listened.items():
                for place in places:
                    self._hear(place, heard.get(topic, 0), now)
        hanging: Set[str] = set()
        mute = set(self.mute & set(records))
        for name in sorted(asked):
            if self._due.get(name, now) > now:
                continue
            least = min(limits[place] for place in asked[name])
            self._due[name] = now + max(least / _LOOKS, _LEAST_PERIOD)
            sent = self._sent(records[name], hanging, mute)
            for place in asked[name]:
                ear = self._ears.get(place)
                self._hear(place, sent.get(place[1], ear.count if ear else 0), now)
        self.mute = frozenset(mute)

    def _sent(self, record: Record, hanging: Set[str], mute: Set[str]) -> Mapping[str, int]:
        """Ask a nodelet for its counts, and note if it does not answer."""
        if record.manager not in hanging:
            try:
                sent = self._host.sent(record.name)
            except HostTimeout:
                hanging.add(record.manager)  # each of its other nodelets would take that long
            except HostError:
                pass  # it is gone, or just going, which says nothing of its neighbours
            else:
                mute.discard(record.name)
                return sent
        mute.add(record.name)
        return {}

    def _hear(self, place: Place, count: int, now: float) -> None:
        ear = self._ears.get(place)
        if ear is None:
            self._ears[place] = _Ear(count, now, count > 0)
        elif count != ear.count:
            ear.count, ear.since, ear.begun = count, now, True
            self.silent.pop(place[0] or place[1], None)

    def _judge(self, claim: Claim, places: Mapping[Place, str]) -> Set[str]:
        now = self._clock()
        limit = claim.request.max_silence
        quiet: Dict[str, str] = {}
        for place, topic in places.items():
            ear = self._ears.get(place)
            if ear is None:
                continue
            allowed = limit if ear.begun else max(limit, FIRST_MESSAGE)
            if now - ear.since > allowed:
                quiet[topic] = place[0] or topic
        fallen = set()
        for name in sorted(set(quiet.values())):
            fed_by = claim.wiring.get(name, {}).values()
            starved = any(topic in quiet and quiet[topic] != name for topic in fed_by)
            if not starved and name not in self.silent:
                what = f"nodelet {name}" if name in claim.wiring else f"topic {name}"
                self.silent[name] = f"{what} was silent for longer than {limit:g} s"
                fallen.add(name)
        return fallen

    def _forget(self, known: Mapping[str, Record]) -> None:
        heard = {name or topic for name, topic in self._ears}
        for name in [name for name in self.silent if name not in heard]:
            del self.silent[name]
        for name in [name for name in self._due if name not in known]:
            del self._due[name]
        self.mute = self.mute & frozenset(known)
