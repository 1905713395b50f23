# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The producers and consumers of each topic, at one moment.

A port counts on each topic on which it may be: where it was seen last, where it should be, and
where a connection without an answer may have put it.

The tags that a nodelet with variables sends follow from those that it receives. Where these are
not certain, each possibility counts. Messages since its last connection bind its variables, even
if nothing sends there any more. As long as a variable of an out-port is unbound, the nodelet has
received nothing and sends nothing there. What people connect to a topic of which nothing is known
may receive anything there.
"""

from __future__ import annotations

import copy
import itertools
import math
from functools import cached_property
from typing import AbstractSet, Callable, Collection, Iterable, Iterator, Mapping, Sequence, Tuple

from dyknow.datatypes import same_type
from dyknow.manager.claim import Claim
from dyknow.manager.claims.ends import (
    Consumer,
    Inlet,
    NodeletEnds,
    Producer,
    Sent,
    Way,
    supplied,
    ways_to_bind,
)
from dyknow.manager.planning.problem import Demand, meets, ways_to_meet
from dyknow.manager.record import NOTHING_HEARD, Heard
from dyknow.manager.specifications.tags import Subsumption, Term, parse_tag, read_tags
from dyknow.model.transformation import Transformation

#: Possibilities that are distinguished; beyond, no supply is certain.
_MOST_POSSIBILITIES = 16
#: A stream about which nothing is known.
_UNKNOWN: tuple[Sent, ...] = (((), ""),)
#: An in-port whose demand is not met.
_CONFUSED = Inlet(Demand(frozenset((Term("nothing"),))), _UNKNOWN)

_Key = Tuple[int, str]
"""Number of a nodelet, and its port."""


class DependentNodelets:
    """The streams of nodelets with variables; these are numbered as they come."""

    def __init__(
        self, producers: Callable[[str], Sequence[Producer]], ontology: Subsumption
    ) -> None:
        self._producers = producers
        self._ontology = ontology
        self._nodelets: list[NodeletEnds] = []
        self._inputs: list[dict[str, tuple[Consumer, tuple[str, ...]]]] = []
        self._places: dict[str, list[_Key]] = {}
        self._possible: dict[_Key, tuple[Producer, ...]] = {}
        self._beside: dict[_Key, list[list[Way]]] = {}

    def __len__(self) -> int:
        """Count the nodelets."""
        return len(self._nodelets)

    def add(self, ends: NodeletEnds) -> int:
        """Add a nodelet; returns its number. Its ends are placed on topics one by one."""
        self._nodelets.append(ends)
        self._inputs.append({})
        return len(self._nodelets) - 1

    def place_consumer(self, consumer: Consumer, topics: tuple[str, ...]) -> None:
        """Say where an in-port may be."""
        self._inputs[consumer.ends][consumer.port] = consumer, topics

    def place_producer(self, number: int, port: str, topic: str) -> None:
        """Say that an out-port with variables may be on a topic."""
        self._places.setdefault(topic, []).append((number, port))

    def on(self, topic: str) -> list[Producer]:
        """Return what out-ports with variables may send on a topic."""
        return [each for key in self._places.get(topic, ()) for each in self._possible[key]]

    def bind(self) -> None:
        """Bind the variables of nodelets, from the sources on."""
        self._beside.clear()
        self._possible = {
            (number, producer.port): (producer._replace(tags=(), is_unbound=True),)
            for number, ends in enumerate(self._nodelets)
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
        """Bind the variables of one nodelet; whether that changed its streams."""
        ends = self._nodelets[number]
        possible = [self._ways(number, inlets) for inlets in self._inlets(number)]
        is_changed = False
        for pattern, _ in ends.producers:
            key = number, pattern.port
            if key in self._possible:
                found = tuple(dict.fromkeys(_bound(pattern, ways) for ways in possible))
                is_changed = is_changed or found != self._possible[key]
                self._possible[key] = found
        return is_changed

    def _ways(self, number: int, inlets: Iterable[Inlet]) -> list[Way]:
        return ways_to_bind(self._nodelets[number].known, inlets, self._ontology)

    def _inlets(self, number: int, but: str = "") -> list[tuple[Inlet, ...]]:
        """List the streams that the in-ports of a nodelet, ``but`` one, may receive together."""
        choices: list[list[Inlet | None]] = []
        for port, (consumer, topics) in self._inputs[number].items():
            if port == but or not consumer.variables:
                continue
            found: dict[tuple[Sent, ...], None] = {}
            for topic in topics:
                if self._nodelets[number].is_by_hand and not self._producers(topic):
                    found[_UNKNOWN] = None
                else:
                    found.update(dict.fromkeys(self._sent(topic)))
            choices.append([Inlet(consumer.demand, sent) if sent else None for sent in found])
        if math.prod(len(each) or 1 for each in choices) > _MOST_POSSIBILITIES:
            return [(_CONFUSED,)]
        return [
            tuple(inlet for inlet in combination if inlet is not None)
            for combination in itertools.product(*(each or [None] for each in choices))
        ]

    def _sent(self, topic: str) -> list[tuple[Sent, ...]]:
        """List the streams that may be on a topic together."""
        by_source: dict[tuple[str, str], dict[Producer, None]] = {}
        for producer in self._producers(topic):
            by_source.setdefault(producer[:2], {})[producer] = None
        if math.prod(map(len, by_source.values())) > _MOST_POSSIBILITIES:
            return [_UNKNOWN]
        return [
            tuple((each.tags, each.datatype) for each in combination if not each.is_unbound)
            for combination in itertools.product(*by_source.values())
        ]

    def topics_of(self, place: tuple[str, str]) -> list[str]:
        """Return the topics on which an out-port with variables may be: nodelet and port."""
        return [
            topic
            for topic, keys in sorted(self._places.items())
            if any(self._possible[key][0][:2] == place for key in keys)
        ]

    def supplies(self) -> dict[tuple[str, str], frozenset[Producer]]:
        """Return the streams of the out-ports with variables, by nodelet and port."""
        found: dict[tuple[str, str], frozenset[Producer]] = {}
        for possible in self._possible.values():
            place = possible[0].nodelet, possible[0].port
            found[place] = found.get(place, frozenset()).union(possible)
        return found

    def ways(self, nodelet: str) -> list[Way] | None:
        """Return the ways in which a nodelet's variables are bound; None if that is unknown."""
        numbers = [
            number
            for number, inputs in enumerate(self._inputs)
            if any(consumer.nodelet == nodelet for consumer, _ in inputs.values())
        ]
        possible = [inlets for number in numbers for inlets in self._inlets(number)]
        return self._ways(numbers[0], possible[0]) if len(possible) == 1 else None

    def heard(self) -> dict[str, Heard]:
        """Return what each nodelet has received by now, where that is certain."""
        found: dict[str, Heard] = {}
        for number, ends in enumerate(self._nodelets):
            possible = self._inlets(number) if ends.listening else []
            ways = self._ways(number, possible[0]) if len(possible) == 1 else []
            if ways:
                name = next(iter(self._inputs[number].values()))[0].nodelet
                bound = tuple(tuple(sorted(way.items())) for way in ways)
                is_more = ways != [ends.given]
                found[name] = Heard(ends.listening, bound) if is_more else NOTHING_HEARD
        return found

    def ports_beside(self, consumer: Consumer) -> list[str]:
        """Return the in-ports that have to be changed with one, since they share variables."""
        variables, size = consumer.variables, -1
        inputs = [each for each, topics in self._inputs[consumer.ends].values() if topics]
        while len(variables) > size:
            size = len(variables)
            for each in inputs:
                if each.variables & variables:
                    variables |= each.variables
        return [each.port for each in inputs if each.variables & variables]

    def fits(self, producer: Producer, consumer: Consumer) -> bool:
        """Whether a producer meets an in-port's demand, beside the other inputs of its nodelet."""
        key = consumer.ends, consumer.port
        if key not in self._beside:
            known = list(self._nodelets[consumer.ends].known)
            others = self._inlets(*key)
            self._beside[key] = [self._ways(key[0], inlets) or known for inlets in others]
        tags, datatype, demand = producer.tags, producer.datatype, consumer.demand
        return all(
            any(
                next(ways_to_meet(tags, datatype, demand, self._ontology, way), None) is not None
                for way in ways
            )
            for ways in self._beside[key]
        )


def _bound(pattern: Producer, ways: list[Way]) -> Producer:
    tags = supplied(pattern.tags, ways)
    is_open = any(not tag.substitute(way).is_ground for way in ways[:1] for tag in pattern.tags)
    return pattern._replace(tags=tags, is_unbound=is_open)


def demand_of(claims: Iterable[Claim]) -> Demand:
    """Return what one stream has to be to satisfy all these claims."""
    claims = list(claims)
    types = [wanted_type(claim) for claim in claims]
    tags = frozenset(parse_tag(claim.request.tag) for claim in claims)
    min_rate = max(claim.request.min_rate for claim in claims)
    ages = [claim.request.max_age for claim in claims if claim.request.max_age]
    return Demand(tags, types[0] or max(types), min_rate, min(ages, default=0.0))


def wanted_type(claim: Claim) -> str:
    """Return the ROS type that a claim's client expects: of its request, or its first stream."""
    return claim.request.datatype or claim.datatype.replace("*", "")


def may_share(claim: Claim, other: Claim) -> bool:
    """Whether every stream that satisfies ``other``, now or later, satisfies ``claim``."""
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
        described: Mapping[str, Sequence[Transformation]],
        claims: Iterable[Claim],
        perhaps: Mapping[tuple[str, str], Collection[str]],
        ontology: Subsumption,
    ) -> None:
        """Enter every producer and consumer.

        ``described`` has transformations of type topic by topic, ``perhaps`` further topics on
        which ports may be, by nodelet and port.
        """
        self._described = described
        self._perhaps = perhaps
        self._ontology = ontology
        self._nodelets = tuple(nodelets)
        self._claims = tuple(claims)
        self._producers: dict[str, list[Producer]] = {}
        self._consumers: dict[str, list[Consumer]] = {}
        for claim in self._claims:
            client = Consumer("", claim.claim_id, demand_of([claim]))
            self._consumers.setdefault(claim.topic, []).append(client)
        #: Nodelets whose streams depend on their inputs.
        self.dependent = DependentNodelets(self.producers, ontology)
        for ends in self._nodelets:
            self._enter(ends)
        self._relays = {each.name for each in self._nodelets if each.is_relay}
        self.dependent.bind()
        self._distrust(self._relays)

    def _enter(self, ends: NodeletEnds) -> None:
        number = self.dependent.add(ends) if ends.has_variables else -1
        for consumer, topics in ends.consumers:
            everywhere = tuple(self._all(topics, consumer))
            if ends.has_variables:
                consumer = consumer._replace(ends=number)
                self.dependent.place_consumer(consumer, everywhere)
            for topic in everywhere:
                self._consumers.setdefault(topic, []).append(consumer)
        for producer, topics in ends.producers:
            is_open = any(not tag.is_ground for tag in producer.tags)
            for topic in self._all(topics, producer):
                if is_open:
                    self.dependent.place_producer(number, producer.port, topic)
                elif producer.tags or topic not in self._described:
                    self._producers.setdefault(topic, []).append(producer)

    def changed(
        self,
        gone: Sequence[NodeletEnds],
        new: Sequence[NodeletEnds],
        nodelets: Iterable[NodeletEnds] = (),
    ) -> Topology:
        """Return a topology without ``gone`` and with ``new`` nodelets.

        It shares the rest with this one unless streams of nodelets depend on their inputs.
        ``nodelets`` are all that it has, if their order matters.
        """
        nodelets = [*nodelets] or [each for each in self._nodelets if each not in gone] + [*new]
        if (
            self._relays
            or self.dependent
            or any(each.has_variables or each.is_relay for each in new)
        ):
            return Topology(nodelets, self._described, self._claims, self._perhaps, self._ontology)
        found = copy.copy(self)
        for name in ("_all_mismatches", "heard"):
            found.__dict__.pop(name, None)
        found._nodelets = tuple(nodelets)
        found._producers = {topic: list(each) for topic, each in self._producers.items()}
        found._consumers = {topic: list(each) for topic, each in self._consumers.items()}
        for ends in gone:
            for producer, topics in ends.producers:
                for topic in self._all(topics, producer):
                    if producer in found._producers.get(topic, ()):
                        found._producers[topic].remove(producer)
            for consumer, topics in ends.consumers:
                for topic in self._all(topics, consumer):
                    found._consumers[topic].remove(consumer)
        for ends in new:
            found._enter(ends)
        return found

    def _all(self, topics: tuple[str, ...], end: Producer | Consumer) -> Iterable[str]:
        """Return the topics on which a port may be."""
        further = self._perhaps.get((end.nodelet, end.port), ())
        return sorted({*topics, *further} - {""}) if further else topics

    def _described_on(self, topic: str) -> list[Producer]:
        """Return the ordinary nodes that the library describes, as one producer."""
        ports = [each.ports[0] for each in self._described.get(topic, ())]
        tags = tuple(term for port in ports for term in read_tags(port.tags))
        datatype = next((port.datatype for port in ports if port.datatype), "")
        return [Producer("", "", tags, datatype)] if ports else []

    def _distrust(self, relays: AbstractSet[str]) -> None:
        """Take away the tags of relays that may receive something else than these say."""
        misled: AbstractSet[str] = relays
        while relays and misled:
            found = self._mismatches(self._consumers)
            receiving = {consumer.nodelet for _, _, consumer in found}
            misled, relays = relays & receiving, relays - receiving
            for producers in self._producers.values():
                producers[:] = [
                    each._replace(tags=()) if each.nodelet in misled else each
                    for each in producers
                ]
            if misled:
                self.dependent.bind()

    def listened_to(self, topics: Mapping[str, str]) -> list[str]:
        """Return those ports, each with its topic, on whose topic nodelets have variables."""
        return [
            port
            for port, topic in topics.items()
            if any(consumer.ends >= 0 for consumer in self.consumers(topic))
        ]

    def producers(self, topic: str) -> list[Producer]:
        """Return the producers of a topic; its description stands for nodelets without tags."""
        return [
            *self._described_on(topic),
            *self._producers.get(topic, ()),
            *self.dependent.on(topic),
        ]

    def is_described(self, topic: str) -> bool:
        """Whether the library describes what ordinary nodes send on a topic."""
        return topic in self._described

    def ports_of(self, consumer: Consumer) -> list[str]:
        """Return the in-ports of a nodelet that are connected elsewhere together with one."""
        together = self.dependent.ports_beside(consumer) if consumer.ends >= 0 else []
        return together or [consumer.port]

    def consumers(self, topic: str) -> list[Consumer]:
        """Return the consumers of a topic."""
        return self._consumers.get(topic, [])

    def serves(self, producer: Producer, demand: Demand) -> bool:
        """Whether a producer meets a demand with all that it sends."""
        return producer.is_unbound or meets(
            producer.tags, producer.datatype, demand, self._ontology
        )

    def ways_to_serve(self, producer: Producer, claim: Claim) -> list[Way]:
        """List the names that the variables of a claim may stand for in a producer's stream."""
        demand = demand_of([claim])
        return list(ways_to_meet(producer.tags, producer.datatype, demand, self._ontology))

    def fits(self, producer: Producer, consumer: Consumer) -> bool:
        """Whether a producer meets a consumer's demand, beside the other inputs of its nodelet."""
        if consumer.ends < 0 or producer.is_unbound:
            return self.serves(producer, consumer.demand)
        return self.dependent.fits(producer, consumer)

    def mismatches(
        self, topics: Iterable[str] | None = None
    ) -> Iterable[tuple[str, Producer, Consumer]]:
        """Return each topic, producer and consumer that may meet there and do not fit."""
        return self._all_mismatches if topics is None else self._mismatches(topics)

    @cached_property
    def _all_mismatches(self) -> tuple[tuple[str, Producer, Consumer], ...]:
        return tuple(self._mismatches(self._consumers))

    @cached_property
    def heard(self) -> Mapping[str, Heard]:
        """The messages that bound the variables of nodelets, where they are certain."""
        return self.dependent.heard()

    def _mismatches(self, topics: Iterable[str]) -> Iterator[tuple[str, Producer, Consumer]]:
        for topic in sorted(set(topics)):
            for consumer in self.consumers(topic):
                for producer in self.producers(topic):
                    if not self.fits(producer, consumer):
                        yield topic, producer, consumer

    def common_tags(self, topic: str, tags: tuple[Term, ...]) -> tuple[Term, ...]:
        """Return those of a stream's tags that hold for everything that is sent on its topic."""
        producers = self.producers(topic)
        return tuple(
            tag
            for tag in tags
            if all(self.serves(each, Demand(frozenset((tag,)))) for each in producers)
        )
