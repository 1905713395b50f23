# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Who may receive what from whom: the producers and consumers of each topic, at one moment.

A port counts on each topic on which it may be: where it was seen last, where it should be, and
where a connection without an answer may have put it.
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
    NamedTuple,
    Optional,
    Tuple,
)

from dyknow.manager.claim import Claim
from dyknow.manager.claims.relay import is_relay
from dyknow.manager.planning.supply import Demand, meets
from dyknow.manager.record import Record
from dyknow.manager.specifications.tags import Subsumption, Term, parse_tag, read_tags
from dyknow.model.transformation import OUT, Port, Transformation


class Producer(NamedTuple):
    """An out-port, or the ordinary nodes that publish on a topic.

    Attributes:
        nodelet: its name; empty for ordinary nodes.
        port: its out-port; empty for ordinary nodes.
        tags: what its messages are about.
        datatype: ROS type of its messages.
    """

    nodelet: str
    port: str
    tags: Tuple[Term, ...] = ()
    datatype: str = ""


class Consumer(NamedTuple):
    """A tagged in-port, or the client of a claim.

    Attributes:
        nodelet: its name; empty for a client.
        port: its in-port, or the id of the claim.
        demand: what it has to receive, and nothing else.
    """

    nodelet: str
    port: str
    demand: Demand


class NodeletEnds(NamedTuple):
    """What a nodelet contributes to a topology, each end with the topics on which it is.

    The tags are those that the nodelet was made with, whatever the library says now.
    """

    is_relay: bool
    producers: Tuple[Tuple[Producer, Tuple[str, ...]], ...]
    consumers: Tuple[Tuple[Consumer, Tuple[str, ...]], ...]


def ends_of(record: Record) -> NodeletEnds:
    """Read the ends of a nodelet."""
    producers: List[Tuple[Producer, Tuple[str, ...]]] = []
    consumers: List[Tuple[Consumer, Tuple[str, ...]]] = []
    seen = {port.name: port for port in record.ports}
    for port in _ports(record):
        tags = read_tags(port.tags)
        topics = {record.topics.get(port.name, "")}
        if port.name in seen:
            topics.add(seen[port.name].topic)
        where = tuple(sorted(topics - {""}))
        if port.direction == OUT:
            producers.append((Producer(record.name, port.name, tags, port.datatype), where))
        elif tags:
            demand = Demand(frozenset(tags), port.datatype)
            consumers.append((Consumer(record.name, port.name, demand), where))
    return NodeletEnds(is_relay(record.transformation), tuple(producers), tuple(consumers))


def _ports(record: Record) -> List[Port]:
    """Declared ports with the types that were seen, then those that are not declared."""
    seen = {port.name: port for port in record.ports}
    declared = record.transformation.ports if record.transformation is not None else ()
    names = {port.name for port in declared}
    found = [
        port._replace(datatype=seen[port.name].datatype or port.datatype)
        if port.name in seen
        else port
        for port in declared
    ]
    found += [
        Port(port.name, port.direction, port.datatype)
        for port in record.ports
        if port.name not in names
    ]
    return found


def demand_of(claims: Iterable[Claim]) -> Demand:
    """Return what one stream has to be to satisfy all these claims."""
    claims = list(claims)
    types = [wanted_type(claim) for claim in claims]
    tags = frozenset(parse_tag(claim.request.tag) for claim in claims)
    return Demand(tags, types[0] or max(types))


def wanted_type(claim: Claim) -> str:
    """Return the ROS type that a claim's client expects: what it asked for, or received first."""
    return claim.request.datatype or claim.datatype.replace("*", "")


def may_share(claim: Claim, other: Claim) -> bool:
    """Whether every stream that satisfies ``other``, now or later, satisfies ``claim``.

    Then one topic serves both clients.
    """
    return (
        parse_tag(claim.request.tag) == parse_tag(other.request.tag)
        and wanted_type(claim) in ("", wanted_type(other))
        and set(claim.request.exclude) == set(other.request.exclude)
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
        for ends in nodelets:
            for consumer, topics in ends.consumers:
                for topic in _all(topics, perhaps, consumer):
                    self._consumers.setdefault(topic, []).append(consumer)
            for producer, topics in ends.producers:
                places += [(topic, producer) for topic in _all(topics, perhaps, producer)]
                if ends.is_relay:
                    relays.add(producer.nodelet)
        used = self._consumers.keys() | {topic for topic, _ in places}
        self._describe(each for each in described if each.source in used)
        said = set(self._producers)
        for topic, producer in places:
            if producer.tags or topic not in said:
                self._producers.setdefault(topic, []).append(producer)
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

    def producers(self, topic: str) -> List[Producer]:
        """Return the producers of a topic; its description stands for nodelets without tags."""
        return self._producers.get(topic, [])

    def is_described(self, topic: str) -> bool:
        """Whether the library describes what ordinary nodes send on a topic."""
        return any(not producer.nodelet for producer in self.producers(topic))

    def consumers(self, topic: str) -> List[Consumer]:
        """Return the consumers of a topic."""
        return self._consumers.get(topic, [])

    def serves(self, producer: Producer, demand: Demand) -> bool:
        """Whether a producer sends what is demanded."""
        return meets(producer.tags, producer.datatype, demand, self._ontology)

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
                    if not self.serves(producer, consumer.demand):
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
