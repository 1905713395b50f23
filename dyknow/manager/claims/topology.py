# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Who may receive what from whom: the producers and consumers of each topic, at one moment.

A port counts on each topic on which it may be: where it was seen last, where it should be, and
where a connection without an answer may have put it. What a nodelet with variables sends follows
from what it receives (``bound_tags``); where that is not certain, each possibility counts. As long
as its variables are unbound, it has received nothing and sends nothing.
"""

from __future__ import annotations

import itertools
import math
from typing import (
    AbstractSet,
    Collection,
    Dict,
    FrozenSet,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Tuple,
)

from dyknow.manager.claim import Claim
from dyknow.manager.claims.bound_tags import Inlet, Sent, Way, supplied, ways_to_bind
from dyknow.manager.claims.relay import is_relay
from dyknow.manager.planning.supply import Demand, meets, ways_to_meet
from dyknow.manager.record import Record
from dyknow.manager.specifications.tags import (
    NO_BINDINGS,
    Subsumption,
    Term,
    parse_tag,
    read_tags,
)
from dyknow.model.transformation import OUT, Port, Transformation

#: Possibilities that are told apart; beyond, nothing is known to be supplied.
_MOST_POSSIBILITIES = 16
#: An in-port that does not receive what it demands.
_CONFUSED = Inlet(Demand(frozenset((Term("nothing"),))), (((), ""),))


class Producer(NamedTuple):
    """An out-port, or the ordinary nodes that publish on a topic.

    Attributes:
        nodelet: its name; empty for ordinary nodes.
        port: its out-port; empty for ordinary nodes.
        tags: what its messages are about.
        datatype: ROS type of its messages.
        is_unbound: whether it sends nothing, since a variable of its tags is bound to nothing.
    """

    nodelet: str
    port: str
    tags: Tuple[Term, ...] = ()
    datatype: str = ""
    is_unbound: bool = False


class Consumer(NamedTuple):
    """A tagged in-port, or the client of a claim.

    Attributes:
        nodelet: its name; empty for a client.
        port: its in-port, or the id of the claim.
        demand: what it has to receive, and nothing else.
        ends: number of its nodelet among those whose in-ports depend on each other; else -1.
    """

    nodelet: str
    port: str
    demand: Demand
    ends: int = -1


class NodeletEnds(NamedTuple):
    """What a nodelet contributes to a topology, each end with the topics on which it is.

    The tags are those that the nodelet was made with, whatever the library says now.

    Attributes:
        is_relay: whether it sends what it receives.
        producers: its out-ports.
        consumers: its tagged in-ports.
        given: what its variables stand for in any case.
        has_variables: whether what it receives at one port says what it may receive at another,
            or what it sends.
    """

    is_relay: bool
    producers: Tuple[Tuple[Producer, Tuple[str, ...]], ...]
    consumers: Tuple[Tuple[Consumer, Tuple[str, ...]], ...]
    given: Way = NO_BINDINGS
    has_variables: bool = False


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
    in_ports = [
        variable
        for each, _ in consumers
        for variable in {name for tag in each.demand.tags for name in tag.variables}
    ]
    return NodeletEnds(
        is_relay(record.transformation),
        tuple(producers),
        tuple(consumers),
        record.given,
        bool(record.given)
        or len(set(in_ports)) < len(in_ports)
        or any(not tag.is_ground for producer, _ in producers for tag in producer.tags),
    )


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
        self._dependent: List[NodeletEnds] = []
        self._possible: Dict[Tuple[int, str], Tuple[Producer, ...]] = {}
        self._places: Dict[str, List[Tuple[int, str]]] = {}
        self._inputs: List[Dict[str, Tuple[Consumer, Tuple[str, ...]]]] = []
        self._beside: Dict[Tuple[int, str], List[List[Way]]] = {}
        for ends in nodelets:
            number = -1
            if ends.has_variables:
                number = len(self._dependent)
                self._dependent.append(ends)
                self._inputs.append({})
            for consumer, topics in ends.consumers:
                everywhere = tuple(_all(topics, perhaps, consumer))
                if ends.has_variables:
                    consumer = consumer._replace(ends=number)
                    self._inputs[number][consumer.port] = consumer, everywhere
                for topic in everywhere:
                    self._consumers.setdefault(topic, []).append(consumer)
            for producer, topics in ends.producers:
                is_open = any(not tag.is_ground for tag in producer.tags)
                for topic in _all(topics, perhaps, producer):
                    if is_open:
                        self._places.setdefault(topic, []).append((number, producer.port))
                    else:
                        places.append((topic, producer))
                if ends.is_relay:
                    relays.add(producer.nodelet)
        used = self._consumers.keys() | {topic for topic, _ in places} | self._places.keys()
        self._describe(each for each in described if each.source in used)
        said = set(self._producers)
        for topic, producer in places:
            if producer.tags or topic not in said:
                self._producers.setdefault(topic, []).append(producer)
        self._bind()
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
                self._bind()

    # Variables

    def _bind(self) -> None:
        """Bind the variables of nodelets, from the sources on."""
        self._beside.clear()
        self._possible = {
            (number, producer.port): (producer._replace(tags=(), is_unbound=True),)
            for number, ends in enumerate(self._dependent)
            for producer, _ in ends.producers
            if any(not tag.is_ground for tag in producer.tags)
        }
        numbers = sorted({number for number, _ in self._possible})
        for _ in range(len(numbers) + 1):
            if not [number for number in numbers if self._bind_one(number)]:
                return
        for key, found in self._possible.items():  # it feeds itself, and never settles
            self._possible[key] = (found[0]._replace(tags=(), is_unbound=False),)

    def _bind_one(self, number: int) -> bool:
        """Bind the variables of one nodelet; whether that changed what it sends."""
        ends = self._dependent[number]
        possible = [self._ways(number, inlets) for inlets in self._inlets(number)]
        is_changed = False
        for pattern, _ in ends.producers:
            key = number, pattern.port
            if key in self._possible:
                found = tuple(dict.fromkeys(_bound(pattern, ways) for ways in possible))
                is_changed = is_changed or found != self._possible[key]
                self._possible[key] = found
        return is_changed

    def _ways(self, number: int, inlets: Iterable[Inlet]) -> List[Way]:
        return ways_to_bind(self._dependent[number].given, inlets, self._ontology)

    def _inlets(self, number: int, but: str = "") -> List[Tuple[Inlet, ...]]:
        """List what the in-ports of a nodelet, ``but`` one, may receive at the same time."""
        choices: List[List[Optional[Inlet]]] = []
        for port, (consumer, topics) in self._inputs[number].items():
            if port == but or not any(tag.variables for tag in consumer.demand.tags):
                continue
            found: Dict[Tuple[Sent, ...], None] = {}
            for topic in topics:
                found.update(dict.fromkeys(self._sent(topic)))
            choices.append([Inlet(consumer.demand, sent) if sent else None for sent in found])
        if math.prod(len(each) or 1 for each in choices) > _MOST_POSSIBILITIES:
            return [(_CONFUSED,)]
        return [
            tuple(inlet for inlet in combination if inlet is not None)
            for combination in itertools.product(*(each or [None] for each in choices))
        ]

    def _sent(self, topic: str) -> List[Tuple[Sent, ...]]:
        """List what may be sent on a topic at the same time."""
        by_source: Dict[Tuple[str, str], Dict[Producer, None]] = {}
        for producer in self.producers(topic):
            by_source.setdefault(producer[:2], {})[producer] = None
        if math.prod(map(len, by_source.values())) > _MOST_POSSIBILITIES:
            return [(((), ""),)]
        return [
            tuple((each.tags, each.datatype) for each in combination if not each.is_unbound)
            for combination in itertools.product(*by_source.values())
        ]

    @property
    def has_variables(self) -> bool:
        """Whether what some nodelet receives says what it sends, or may receive elsewhere."""
        return bool(self._dependent)

    def listened_to(self, topics: Mapping[str, str]) -> List[str]:
        """Return those ports, each with its topic, on whose topic nodelets have variables."""
        return [
            port
            for port, topic in topics.items()
            if any(consumer.ends >= 0 for consumer in self.consumers(topic))
        ]

    def topics_of(self, place: Tuple[str, str]) -> List[str]:
        """Return the topics on which an out-port with variables may be: nodelet and port."""
        return [
            topic
            for topic, keys in sorted(self._places.items())
            if any(self._possible[key][0][:2] == place for key in keys)
        ]

    def supplies(self) -> Dict[Tuple[str, str], FrozenSet[Producer]]:
        """Return what the out-ports with variables may send, by nodelet and port."""
        found: Dict[Tuple[str, str], FrozenSet[Producer]] = {}
        for possible in self._possible.values():
            place = possible[0].nodelet, possible[0].port
            found[place] = found.get(place, frozenset()).union(possible)
        return found

    def ways(self, nodelet: str) -> Optional[List[Way]]:
        """Return the ways in which a nodelet's variables are bound; None if nobody can tell."""
        numbers = [
            number
            for number, inputs in enumerate(self._inputs)
            if any(consumer.nodelet == nodelet for consumer, _ in inputs.values())
        ]
        possible = [inlets for number in numbers for inlets in self._inlets(number)]
        return self._ways(numbers[0], possible[0]) if len(possible) == 1 else None

    # Ends

    def producers(self, topic: str) -> List[Producer]:
        """Return the producers of a topic; its description stands for nodelets without tags."""
        known = self._producers.get(topic, [])
        if topic not in self._places:
            return known
        return [*known, *(each for key in self._places[topic] for each in self._possible[key])]

    def is_described(self, topic: str) -> bool:
        """Whether the library describes what ordinary nodes send on a topic."""
        return any(not producer.nodelet for producer in self.producers(topic))

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
        key = consumer.ends, consumer.port
        if key not in self._beside:
            given = self._dependent[consumer.ends].given
            others = self._inlets(*key)
            self._beside[key] = [self._ways(key[0], inlets) or [given] for inlets in others]
        tags, datatype, demand = producer.tags, producer.datatype, consumer.demand
        return all(
            any(
                next(ways_to_meet(tags, datatype, demand, self._ontology, way), None) is not None
                for way in ways
            )
            for ways in self._beside[key]
        )

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


def _bound(pattern: Producer, ways: List[Way]) -> Producer:
    tags = supplied(pattern.tags, ways)
    is_open = any(not tag.substitute(way).is_ground for way in ways[:1] for tag in pattern.tags)
    return pattern._replace(tags=tags, is_unbound=is_open)


def _all(
    topics: Tuple[str, ...],
    perhaps: Mapping[Tuple[str, str], Collection[str]],
    end: Producer | Consumer,
) -> Iterable[str]:
    further = perhaps.get((end.nodelet, end.port), ()) if perhaps else ()
    return sorted({*topics, *further} - {""}) if further else topics
