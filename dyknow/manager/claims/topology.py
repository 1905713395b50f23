# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Who may receive what from whom: the producers and consumers of each topic, at one moment.

A port counts on each topic on which it may be: where it was seen last, where it should be, and
where a connection without an answer may have put it. What nodelets with variables send follows
from what they receive (``dependent_nodelets``).
"""

from __future__ import annotations

from typing import (
    AbstractSet,
    Collection,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    Optional,
    Tuple,
)

from dyknow.datatypes import same_type
from dyknow.manager.claim import Claim
from dyknow.manager.claims.bound_tags import Way
from dyknow.manager.claims.dependent_nodelets import DependentNodelets
from dyknow.manager.claims.ends import Consumer, NodeletEnds, Producer
from dyknow.manager.planning.supply import Demand, meets, ways_to_meet
from dyknow.manager.specifications.tags import (
    Subsumption,
    Term,
    parse_tag,
    read_tags,
)
from dyknow.model.transformation import Transformation


def demand_of(claims: Iterable[Claim]) -> Demand:
    """Return what one stream has to be to satisfy all these claims."""
    claims = list(claims)
    types = [wanted_type(claim) for claim in claims]
    tags = frozenset(parse_tag(claim.request.tag) for claim in claims)
    min_rate = max(claim.request.min_rate for claim in claims)
    ages = [claim.request.max_age for claim in claims if claim.request.max_age]
    return Demand(tags, types[0] or max(types), min_rate, min(ages, default=0.0))


def wanted_type(claim: Claim) -> str:
    """Return the ROS type that a claim's client expects: what it asked for, or received first."""
    return claim.request.datatype or claim.datatype.replace("*", "")


def may_share(claim: Claim, other: Claim) -> bool:
    """Whether every stream that satisfies ``other``, now or later, satisfies ``claim``.

    Then one topic serves both clients.
    """
    mine, theirs = claim.request, other.request
    return (
        parse_tag(mine.tag) == parse_tag(theirs.tag)
        and (not wanted_type(claim) or same_type(wanted_type(claim), wanted_type(other)))
        and set(mine.exclude) == set(theirs.exclude)
        and mine.min_rate <= theirs.min_rate
        and (not mine.max_age or 0 < theirs.max_age <= mine.max_age)
        and set(mine.prefer) == set(theirs.prefer)
        and set(mine.avoid) == set(theirs.avoid)
    )


class Topology:
    """Producers and consumers by topic."""

    def __init__(
        self,
        nodelets: Iterable[NodeletEnds],
        described: Iterable[Transformation],
        claims: Iterable[Claim],
        perhaps: Mapping[Tuple[str, str], Collection[str]],
        ontology: Subsumption,
    ) -> None:
        """Enter every producer and consumer.

        Args:
            nodelets: those that may send or receive.
            described: transformations of type topic.
            claims: those whose clients listen.
            perhaps: further topics on which ports may be, by nodelet and port.
            ontology: what is a kind of what.
        """
        self._ontology = ontology
        self._producers: Dict[str, List[Producer]] = {}
        self._consumers: Dict[str, List[Consumer]] = {}
        for claim in claims:
            client = Consumer("", claim.claim_id, demand_of([claim]))
            self._consumers.setdefault(claim.topic, []).append(client)
        relays = set()
        places: List[Tuple[str, Producer]] = []
        #: Nodelets of which what they receive says what they send, or may receive elsewhere.
        self.dependent = DependentNodelets(self.producers, ontology)
        for ends in nodelets:
            number = self.dependent.add(ends) if ends.has_variables else -1
            for consumer, topics in ends.consumers:
                everywhere = tuple(_all(topics, perhaps, consumer))
                if ends.has_variables:
                    consumer = consumer._replace(ends=number)
                    self.dependent.place_consumer(consumer, everywhere)
                for topic in everywhere:
                    self._consumers.setdefault(topic, []).append(consumer)
            for producer, topics in ends.producers:
                is_open = any(not tag.is_ground for tag in producer.tags)
                for topic in _all(topics, perhaps, producer):
                    if is_open:
                        self.dependent.place_producer(number, producer.port, topic)
                    else:
                        places.append((topic, producer))
                if ends.is_relay:
                    relays.add(producer.nodelet)
        used = self._consumers.keys() | {topic for topic, _ in places} | self.dependent.topics
        self._describe(each for each in described if each.source in used)
        said = set(self._producers)
        for topic, producer in places:
            if producer.tags or topic not in said:
                self._producers.setdefault(topic, []).append(producer)
        self.dependent.bind()
        self._distrust(relays)

    def _describe(self, described: Iterable[Transformation]) -> None:
        """Enter the ordinary nodes that the library describes, one producer for each topic."""
        for each in described:
            port = each.ports[0]
            known = self._producers.get(each.source, [Producer("", "")])[0]
            tags = known.tags + read_tags(port.tags)
            self._producers[each.source] = [
                Producer("", "", tags, known.datatype or port.datatype)
            ]

    def _distrust(self, relays: AbstractSet[str]) -> None:
        """Take away the tags of relays that may receive something else than these say."""
        misled: AbstractSet[str] = relays
        while relays and misled:
            receiving = {consumer.nodelet for _, _, consumer in self.mismatches()}
            misled, relays = relays & receiving, relays - receiving
            for producers in self._producers.values():
                producers[:] = [
                    each._replace(tags=()) if each.nodelet in misled else each
                    for each in producers
                ]
            if misled:
                self.dependent.bind()

    def listened_to(self, topics: Mapping[str, str]) -> List[str]:
        """Return those ports, each with its topic, on whose topic nodelets have variables."""
        return [
            port
            for port, topic in topics.items()
            if any(consumer.ends >= 0 for consumer in self.consumers(topic))
        ]

    def producers(self, topic: str) -> List[Producer]:
        """Return the producers of a topic; its description stands for nodelets without tags."""
        return [*self._producers.get(topic, ()), *self.dependent.on(topic)]

    def is_described(self, topic: str) -> bool:
        """Whether the library describes what ordinary nodes send on a topic."""
        return any(not producer.nodelet for producer in self.producers(topic))

    def ports_of(self, consumer: Consumer) -> List[str]:
        """Return the in-ports of a nodelet that are connected elsewhere together with one."""
        together = self.dependent.ports_beside(consumer) if consumer.ends >= 0 else []
        return together or [consumer.port]

    def consumers(self, topic: str) -> List[Consumer]:
        """Return the consumers of a topic."""
        return self._consumers.get(topic, [])

    def serves(self, producer: Producer, demand: Demand) -> bool:
        """Whether a producer sends what is demanded, and nothing else."""
        return producer.is_unbound or meets(
            producer.tags, producer.datatype, demand, self._ontology
        )

    def ways_to_serve(self, producer: Producer, claim: Claim) -> List[Way]:
        """List what the variables of a claim's tag may stand for in what a producer sends."""
        demand = demand_of([claim])
        return list(ways_to_meet(producer.tags, producer.datatype, demand, self._ontology))

    def fits(self, producer: Producer, consumer: Consumer) -> bool:
        """Whether a producer sends what a consumer demands, beside what its nodelet receives."""
        if consumer.ends < 0 or producer.is_unbound:
            return self.serves(producer, consumer.demand)
        return self.dependent.fits(producer, consumer)

    def mismatches(
        self, topics: Optional[Iterable[str]] = None
    ) -> Iterator[Tuple[str, Producer, Consumer]]:
        """Yield each topic, producer and consumer that may meet there and do not fit.

        Args:
            topics: where to look; everywhere by default.
        """
        for topic in sorted(set(self._consumers if topics is None else topics)):
            for consumer in self.consumers(topic):
                for producer in self.producers(topic):
                    if not self.fits(producer, consumer):
                        yield topic, producer, consumer

    def common_tags(self, topic: str, tags: Tuple[Term, ...]) -> Tuple[Term, ...]:
        """Return those of a stream's tags that hold for everything that is sent on its topic."""
        producers = self.producers(topic)
        return tuple(
            tag
            for tag in tags
            if all(self.serves(each, Demand(frozenset((tag,)))) for each in producers)
        )


def _all(
    topics: Tuple[str, ...],
    perhaps: Mapping[Tuple[str, str], Collection[str]],
    end: Producer | Consumer,
) -> Iterable[str]:
    further = perhaps.get((end.nodelet, end.port), ()) if perhaps else ()
    return sorted({*topics, *further} - {""}) if further else topics
