# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The world at one moment: which producer sends to which consumer, and the effect of a change.

A world does not change: a changed record makes another world, which shares the rest with this
one. So a connection is judged in the world as it would be, before it is made.

Before a producer comes to a topic, consumers there whose demand it does not meet are disconnected.
A consumer never comes to a topic with a producer that does not meet its demand, nor one with a
variable to a topic with two individuals. A nodelet that does not answer counts on each topic on
which it may be.

The tags that a nodelet with variables sends follow from those that it receives. Where these are
not certain, each possibility counts. Messages since its last connection bind its variables, even
if nothing sends there any more: it may remember them. So before it receives the same variable from
another individual, all its in-ports that share the variable are disconnected, and connected again
as one. As long as a variable of an out-port is unbound, the nodelet has received nothing and sends
nothing there. A nodelet on a topic of which nothing is known may receive anything there, unless a
claim needs that connection.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import cached_property
from math import inf
from types import MappingProxyType
from typing import AbstractSet, Collection, Dict, Iterable, Iterator, Mapping, Sequence, Tuple

from dyknow.errors import WrongStream
from dyknow.manager.claim import Claim
from dyknow.manager.claims.ends import (
    NOWHERE,
    Consumer,
    Ends,
    Inlet,
    Late,
    Producer,
    Sent,
    Way,
    ends_of,
    sent_on,
    supplied,
    ways_to_bind,
)
from dyknow.manager.planning.problem import Demand, Live, TaggedStream, meets, ways_to_meet
from dyknow.manager.record import NOTHING_HEARD, Heard, Record, Records, ports_on
from dyknow.manager.specifications.tags import Subsumption, Term, read_tags
from dyknow.model.graph import State
from dyknow.model.transformation import OUT, Transformation

Config = Mapping[str, str]
"""Topics by port; an empty topic disconnects."""
Mismatch = Tuple[str, Producer, Consumer]
"""A topic, and two that may meet there and do not fit."""
Place = Tuple[str, str]
"""A nodelet, or the key of ends, and a port."""
Wire = Tuple[str, str, str]
"""A nodelet, its port, and the topic that it is connected to."""
_Outputs = Dict[Place, Tuple[Producer, ...]]
"""Each possibility of the out-ports whose streams depend on what their nodelets receive."""

#: Possibilities that are distinguished; beyond, no supply is certain.
_MOST_POSSIBILITIES = 16
#: A stream about which nothing is known.
_UNKNOWN: tuple[Sent, ...] = (((), ""),)
#: An in-port whose demand is not met.
_CONFUSED = Inlet(Demand(frozenset((Term("nothing"),))), _UNKNOWN)


class World:
    """Nodelets, claims and descriptions of ordinary topics, at one moment."""

    def __init__(
        self,
        ontology: Subsumption,
        described: Mapping[str, tuple[Transformation, ...]],
        late: Late = NOWHERE,
        records: Records | None = None,
        claims: tuple[Claim, ...] = (),
        ends: Mapping[str, Ends] = MappingProxyType({}),
    ) -> None:
        """``ends`` are those of nodelets and clients; ports may be on ``late`` topics, too."""
        self.records = Records() if records is None else records  # the nodelets by name
        self.claims = claims  # those that have not ended
        self.described = described  # transformations of type topic, by topic
        self._ontology = ontology
        self._late = late
        self._ends = ends
        #: For an in-port on a topic: how the other in-ports bind variables, and its producers.
        self._beside: dict[tuple[str, str, str], tuple[list[list[Way]], list[Producer]]] = {}

    # Other worlds, which differ a little from this one

    def read(self, records: Records, claims: tuple[Claim, ...], acting: AbstractSet[str]) -> World:
        """Return the world with other records and claims; only changes are read again.

        Nodelets that are not ``acting`` neither send nor receive.
        """
        ends = {
            name: self._ends[name]
            if record is self.records.get(name) and name in self._ends
            else ends_of(record, self._late)
            for name, record in records.items()
            if name in acting
        }
        ends.update({claim.claim_id: _client(claim) for claim in claims if claim.topic})
        return World(self._ontology, self.described, self._late, records, claims, ends)

    def with_records(self, new: Iterable[Record]) -> World:
        """Return the world in which nodelets are as these records say."""
        changed = {record.name: record for record in new}
        ends = {name: ends_of(record, self._late) for name, record in changed.items()}
        return self._derived(Records({**self.records, **changed}), ends)

    def _with(self, record: Record, is_replaced: bool = False) -> World:
        """Return the world if a nodelet were as a record says, besides its present or instead."""
        key = record.name if is_replaced else f"{record.name} then"
        ends = ends_of(record, self._late, key, is_planned=True)
        return self._derived(self.records, {key: ends})

    def _derived(self, records: Records, ends: Mapping[str, Ends]) -> World:
        ends = {**self._ends, **ends}
        return World(self._ontology, self.described, self._late, records, self.claims, ends)

    @cached_property
    def forgetful(self) -> World:
        """The world if nodelets remembered nothing."""
        heard = [self.records[each.key] for each in self._dependent if each.heard]
        return self.with_records([replace(each, heard=NOTHING_HEARD) for each in heard])

    @cached_property
    def _producers(self) -> dict[str, list[Producer]]:
        """Producers by topic, the one that the library describes first."""
        found = {topic: [sent_on(topic, each)] for topic, each in self.described.items()}
        for ends in self._ends.values():
            for producer, topics in ends.producers:
                for topic in topics:
                    found.setdefault(topic, []).append(producer)
        for claim in self.claims:
            for topic in claim.sources:  # if it is not described any more
                found.setdefault(topic, [sent_on(topic, ())])
        return found

    @cached_property
    def _consumers(self) -> dict[str, list[Consumer]]:
        """Consumers by topic."""
        found: dict[str, list[Consumer]] = {}
        for ends in self._ends.values():
            for consumer, topics in ends.consumers:
                for topic in topics:
                    found.setdefault(topic, []).append(consumer)
        return found

    # Nodelets

    @cached_property
    def needed(self) -> frozenset[str]:
        """Nodelets that claims are made of."""
        return frozenset([name for claim in self.claims for name in claim.wiring])

    @cached_property
    def users(self) -> tuple[tuple[str, frozenset[str]], ...]:
        """Claims that are made of nodelets, with these."""
        return tuple([(e.claim_id, frozenset(e.wiring)) for e in self.claims if e.wiring])

    @cached_property
    def wires(self) -> frozenset[Wire]:
        """Connections that claims need."""
        return frozenset(wires_of(self.claims))

    def idle(self, reserved: AbstractSet[str]) -> frozenset[str]:
        """Nodelets that were made for claims and go soon: no claim and no request needs them."""
        needed = self.needed | reserved
        return frozenset(
            name
            for name, each in self.records.items()
            if each.claimed and not each.is_protected and name not in needed
        )

    @cached_property
    def described_nodes(self) -> frozenset[str]:
        """Labels of the external nodes that run and that the library describes."""
        records = self.records.values()
        return frozenset([e.label for e in records if e.is_described and e.state is State.RUNNING])

    @cached_property
    def relays(self) -> frozenset[str]:
        return frozenset([key for key, each in self._ends.items() if each.is_relay])

    @property
    def descriptions(self) -> list[Transformation]:
        """Transformations of type topic, with global topics."""
        return [each for found in self.described.values() for each in found]

    def publishers(self, topic: str) -> list[tuple[Record, list[str]]]:
        """Return the nodelets that run and publish on a topic, each with its ports there."""
        found = []
        for name in sorted({each.nodelet for each in self._producers.get(topic, ())} - {""}):
            record = self.records[name]
            ports = ports_on(record, OUT, topic)
            if ports and record.state is State.RUNNING:
                found.append((record, ports))
        return found

    def upstream(
        self, nodelets: Iterable[str], ordinary: AbstractSet[str]
    ) -> tuple[dict[str, dict[str, str]], set[str]]:
        """Find everything that feeds nodelets.

        Returns these nodelets and all upstream of them, with the topics of the ports between
        them, and the topics of ordinary nodes (``ordinary`` ones even beside nodelets).
        """
        wiring: dict[str, dict[str, str]] = {name: {} for name in sorted(nodelets)}
        sources: set[str] = set()
        waiting = list(wiring)
        while waiting:
            name = waiting.pop()
            for port, topic in self._inputs(name):
                if not topic:
                    continue
                wiring[name][port.port] = topic
                publishers = [each for each in self.publishers(topic) if each[0].transformation]
                if not publishers or topic in ordinary:
                    sources.add(topic)
                for publisher, ports in publishers:
                    if publisher.name not in wiring:
                        wiring[publisher.name] = {}
                        waiting.append(publisher.name)
                    wiring[publisher.name].update(dict.fromkeys(ports, topic))
        return wiring, sources

    def _inputs(self, name: str) -> list[tuple[Consumer, str]]:
        """Tagged in-ports of a nodelet, each with the topic where it should be."""
        if name not in self._ends:
            return []
        topics = self.records[name].topics
        return [(each, topics.get(each.port, "")) for each, _ in self._ends[name].consumers]

    # Streams

    def producers(self, topic: str, outputs: _Outputs | None = None) -> list[Producer]:
        """Return the producers of a topic; its description stands for nodelets without tags."""
        outputs = self._outputs if outputs is None else outputs
        here: Sequence[Producer] = self._producers.get(topic, ())
        if topic in self.described:
            here = [each for each in here if each.tags or not each.nodelet]
        found: list[Producer] = []
        for each in here:
            found += outputs.get((each.key, each.port), (each,))
        return found

    def consumers(self, topic: str) -> Sequence[Consumer]:
        return self._consumers.get(topic, ())

    def serves(self, producer: Producer, demand: Demand) -> bool:
        """Whether a producer meets a demand with all that it sends."""
        return producer.is_unbound or meets(
            producer.tags, producer.datatype, demand, self._ontology
        )

    def fits(self, producer: Producer, consumer: Consumer, topic: str) -> bool:
        """Whether a producer meets a consumer's demand, beside all that its nodelet receives.

        Of two on a topic that bind a variable to different individuals, neither fits, unless the
        nodelet's other inputs, or its memory, are of one of these.
        """
        ends, place = self._ends[consumer.key], (consumer.key, consumer.port, topic)
        demand, ontology = consumer.demand, self._ontology
        if producer.is_unbound or not ends.has_variables:
            return self.serves(producer, demand)
        if place not in self._beside:
            others = self._inlets(ends, self._outputs, consumer.port)
            here = self.producers(topic)
            self._beside[place] = (
                [self._ways(ends, each) or [*ends.known] for each in others],
                [each for each in here if len(here) > 1 and self.serves(each, demand)],
            )
        possible, here = self._beside[place]
        here = [each for each in here if each[:2] != producer[:2]]
        if here:
            possible = [
                ways_to_bind(ways, [Inlet(demand, sent)], ontology) or ways
                for ways in possible
                for sent in _together(here)
            ]
        tags, datatype = producer.tags, producer.datatype
        return all(
            any(
                next(ways_to_meet(tags, datatype, demand, ontology, way), None) is not None
                for way in ways
            )
            for ways in possible
        )

    def mismatches(self, topics: Collection[str]) -> list[Mismatch]:
        """Return each producer and consumer that may meet on topics and do not fit."""
        return [
            (topic, producer, consumer)
            for topic in sorted(topics)
            for consumer in self.consumers(topic)
            for producer in self.producers(topic)
            if not self.fits(producer, consumer, topic)
        ]

    @cached_property
    def all_mismatches(self) -> list[Mismatch]:
        return self.mismatches(self._consumers.keys() & self._producers.keys())

    def common_tags(self, topic: str, tags: tuple[Term, ...]) -> tuple[Term, ...]:
        """Return those of a stream's tags that hold for everything that is sent on its topic."""
        for each in self.producers(topic):
            if each.tags != tags:
                tags = tuple([tag for tag in tags if self.serves(each, Demand(frozenset((tag,))))])
        return tags

    def sent(self, nodelet: str, port: str) -> Producer:
        """Return an out-port as a producer; without tags if these are not certain."""
        ends = self._ends.get(nodelet)  # it may have gone meanwhile
        ports = [each for each, _ in ends.producers if each.port == port] if ends else []
        possible = self._outputs.get((nodelet, port), ports)
        first = possible[0] if possible else Producer(nodelet, port)
        return first if len(possible) == 1 else first._replace(tags=())

    def live(
        self, records: Iterable[Record], published: Iterable[Transformation]
    ) -> list[TaggedStream]:
        """List the streams of nodelets and ordinary topics that a plan can use as they are.

        A nodelet's out-ports supply their tags only while each of its tagged in-ports is connected
        to a stream of these that satisfies it. The stated latency of a stream adds to that of the
        latest one that feeds its nodelet; one that states no rate is as fast as the slowest one.
        Only tags that hold for all publishers of a topic count.
        """
        streams: list[TaggedStream] = []
        latencies: dict[str, float] = {}
        rates: dict[str, float] = {}  # infinite if none is stated

        def supply(stream: Live, tags: tuple[Term, ...]) -> None:
            topic = stream.topic
            if topic:
                tags = self.common_tags(topic, tags)
                latencies[topic] = max(stream.latency, latencies.get(topic, 0.0))
                rates[topic] = max(stream.rate or inf, rates.get(topic, 0.0))
            streams.append((stream, tags))

        for each in published:
            port = each.ports[0]
            stream = Live(each.source, "", "", each.label, port.datatype, port.rate, port.latency)
            supply(stream, read_tags(port.tags))
        waiting = [each for each in records if each.state is State.RUNNING and each.transformation]
        count = -1
        while len(waiting) != count:
            count = len(waiting)
            for record in list(waiting):
                inputs = self._inputs(record.name)
                if not all(topic in rates and self._is_fed(each, topic) for each, topic in inputs):
                    continue
                waiting.remove(record)
                begun = max([latencies[topic] for _, topic in inputs], default=0.0)
                slowest = min([rates[topic] for _, topic in inputs], default=inf)
                for stream in _live(record):
                    latency = round(begun + stream.latency, 6)
                    rate = stream.rate or (slowest if slowest < inf else 0.0)
                    tags = self.sent(record.name, stream.port).tags
                    supply(stream._replace(latency=latency, rate=rate), tags)
        return streams

    def _is_fed(self, consumer: Consumer, topic: str) -> bool:
        return all(self.fits(each, consumer, topic) for each in self.producers(topic))

    # Streams that depend on what their nodelets receive

    @cached_property
    def _outputs(self) -> _Outputs:
        """Bind the variables of nodelets, from the sources on."""
        if not self._dependent and not self.relays:
            return {}
        relays = [self._ends[name] for name in sorted(self.relays)]
        unknown: _Outputs = {
            (each.key, each.port): (each._replace(tags=()),)
            for ends in self._dependent
            for each, _ in ends.producers
            if not all(tag.is_ground for tag in each.tags)
        }
        found: _Outputs = {
            place: (each._replace(is_unbound=True),) for place, (each, *_) in unknown.items()
        }
        if not self._settle([*self._dependent, *relays], found):  # something feeds itself
            found = unknown
            self._settle(relays, found)
        return found

    @cached_property
    def _dependent(self) -> list[Ends]:
        """Nodelets with variables."""
        return [each for each in self._ends.values() if each.has_variables]

    def _settle(self, nodelets: Collection[Ends], outputs: _Outputs) -> bool:
        """Follow the streams of nodelets until nothing changes; whether it comes to that."""
        rounds = range(len(nodelets) + 1)
        return any(not [e for e in nodelets if self._send(e, outputs)] for _ in rounds)

    def _send(self, ends: Ends, outputs: _Outputs) -> bool:
        """Derive the possible outputs of a nodelet from its inputs; return whether any is new.

        A relay that may receive anything else than its tags say is not believed.
        """
        found: _Outputs = {}
        if ends.is_relay:
            is_true = all(
                self.serves(producer, consumer.demand)
                for consumer, topics in ends.consumers
                for topic in topics
                for producer in self.producers(topic, outputs)
            )
            for each, _ in ends.producers:
                found[each.key, each.port] = (each if is_true else each._replace(tags=()),)
        else:
            possible = [self._ways(ends, inlets) for inlets in self._inlets(ends, outputs)]
            for each, _ in ends.producers:
                if (each.key, each.port) in outputs:
                    streams = dict.fromkeys([_bound(each, ways) for ways in possible])
                    found[each.key, each.port] = tuple(streams)
        is_new = any(outputs.get(place) != streams for place, streams in found.items())
        outputs.update(found)
        return is_new

    def _ways(self, ends: Ends, inlets: Iterable[Inlet]) -> list[Way]:
        return ways_to_bind(ends.known, inlets, self._ontology)

    def _inlets(self, ends: Ends, outputs: _Outputs, but: str = "") -> list[tuple[Inlet, ...]]:
        """List the streams that the in-ports of a nodelet, ``but`` one, may receive together."""
        choices: list[list[Inlet | None]] = []
        for consumer, topics in ends.consumers:
            if consumer.port == but or not consumer.variables:
                continue
            found: dict[tuple[Sent, ...], None] = {}
            for topic in topics:
                producers = self.producers(topic, outputs)
                wire = (consumer.nodelet, consumer.port, topic)
                is_unknown = not producers and (ends.is_by_hand or wire not in self.wires)
                found.update(dict.fromkeys([_UNKNOWN] if is_unknown else _together(producers)))
            choices.append([Inlet(consumer.demand, sent) if sent else None for sent in found])
        if math.prod(len(each) or 1 for each in choices) > _MOST_POSSIBILITIES:
            return [(_CONFUSED,)]
        return [
            tuple([inlet for inlet in combination if inlet is not None])
            for combination in itertools.product(*(each or [None] for each in choices))
        ]

    def ways(self, nodelet: str) -> list[Way] | None:
        """Return the ways in which a nodelet's variables are bound; None if that is unknown."""
        possible = self._inlets(self._ends[nodelet], self._outputs)
        return self._ways(self._ends[nodelet], possible[0]) if len(possible) == 1 else None

    @cached_property
    def heard(self) -> dict[str, Heard]:
        """What each nodelet with variables has received by now, where that is certain."""
        found: dict[str, Heard] = {}
        for ends in self._dependent:
            ways = self.ways(ends.key) if ends.listening else None
            if ways:
                bound = tuple([tuple(sorted(way.items())) for way in ways])
                is_more = ways != [ends.given]
                found[ends.key] = Heard(ends.listening, bound) if is_more else NOTHING_HEARD
        return found

    def ports_of(self, consumer: Consumer) -> list[str]:
        """Return the in-ports that are connected together with one: they share variables."""
        variables, size = consumer.variables, -1
        inputs = [each for each, topics in self._ends[consumer.key].consumers if topics]
        while len(variables) > size:
            size = len(variables)
            for each in inputs:
                if each.variables & variables:
                    variables |= each.variables
        return [each.port for each in inputs if each.variables & variables] or [consumer.port]

    # Consequences of a connection

    def fitting(self, record: Record) -> dict[str, str]:
        """Return a nodelet's connections, without those that must not be made at present."""
        topics = dict(record.topics)
        then = self._with(record)
        for topic, producer, consumer in then.mismatches({*topics.values()} - {""}):
            for end, other in ((producer, consumer), (consumer, producer)):
                # What people spawned and connected with each other is their own affair.
                is_client = other is consumer and not consumer.nodelet
                concerns_claims = record.claimed or is_client or self._is_made(other)
                if concerns_claims and _is_at(end, record.name, record.topics, topic):
                    topics[end.port] = ""
        if then._dependent and self._misleads(replace(record, topics=topics)):
            for port, topic in topics.items():
                if any(then._ends[each.key].has_variables for each in then.consumers(topic)):
                    topics[port] = ""
        return topics

    def _is_made(self, end: Producer | Consumer) -> bool:
        """Whether a nodelet was made for claims."""
        return end.nodelet in self.records and self.records[end.nodelet].claimed

    def _misleads(self, record: Record) -> bool:
        """Whether nodelets of claims would send wrong streams because of a nodelet."""
        absent = replace(record, topics={}, ports=())
        before = {*self._with(absent, is_replaced=True).all_mismatches}
        return any(
            record.name not in (producer.nodelet, consumer.nodelet)
            and (not consumer.nodelet or self._is_made(producer) or self._is_made(consumer))
            for topic, producer, consumer in self._with(record, is_replaced=True).all_mismatches
            if (topic, producer, consumer) not in before
        )

    def in_the_way(
        self, record: Record, config: Config, silent: AbstractSet[str] = frozenset()
    ) -> dict[str, dict[str, str]]:
        """List the ports to disconnect, by nodelet, before a nodelet's ports may be connected so.

        Once that is done there may be more: it depends on the rest. Raises WrongStream if it must
        not be connected so in any case. Nodelets that are ``silent`` do not answer: they stay if
        that meets their demands.
        """
        record = self.records.get(record.name, record)
        changed = replace(record, topics={**record.topics, **config})
        cut: dict[str, dict[str, str]] = {}
        then = self._with(changed)
        for topic, producer, consumer in then.mismatches({*config.values()} - {""}):
            is_sender = _is_at(producer, record.name, config, topic)
            if _is_at(consumer, record.name, config, topic) or (
                is_sender and not consumer.nodelet
            ):
                raise WrongStream(topic, producer.nodelet, consumer.nodelet)
            if is_sender:
                ports = dict.fromkeys(then.ports_of(consumer), "")
                cut.setdefault(consumer.nodelet, {}).update(ports)
        if cut or not then._dependent:
            return cut
        after = self._with(changed, is_replaced=True)
        misled = list(self._misled(after, {changed.name, "", *silent}))
        # The first along each stream; all of a circle.
        fed = {other.nodelet for _, one, other in misled if one.nodelet != other.nodelet}
        first = [each for each in misled if each[1].nodelet not in fed]
        for topic, producer, consumer in first or misled:
            if not consumer.nodelet or _is_at(consumer, record.name, config, topic):
                raise WrongStream(topic, producer.nodelet, consumer.nodelet)
            ports = dict.fromkeys(after.ports_of(consumer), "")
            cut.setdefault(consumer.nodelet, {}).update(ports)
        return cut

    def _misled(self, after: World, staying: AbstractSet[str]) -> Iterator[Mismatch]:
        """Yield each consumer whose stream would change after a change of a nodelet.

        Those of nodelets that are ``staying``, those without variables, and those to which
        nothing was sent before need not be cut if they want it: they remember nothing else. Those
        whose demand is met neither before nor then need not be cut either.
        """
        before = self._supplies
        for place, possible in sorted(after._supplies.items()):
            known = before.get(place, possible)
            if possible == known or all(each.is_unbound for each in possible):
                continue
            was_silent = all(each.is_unbound for each in known)
            stays = self._topics_of(place) & after._topics_of(place)
            for topic in sorted(stays):
                for consumer in after.consumers(topic):
                    may_stay = was_silent or not consumer.variables or consumer.nodelet in staying
                    was_unmet = not any(self.serves(each, consumer.demand) for each in known)
                    for producer in sorted(possible):
                        if was_unmet and not after.serves(producer, consumer.demand):
                            continue
                        if not may_stay or not after.fits(producer, consumer, topic):
                            yield topic, producer, consumer

    @property
    def _supplies(self) -> dict[Place, frozenset[Producer]]:
        """What out-ports with variables may send."""
        return {
            place: frozenset(possible)
            for place, possible in self._outputs.items()
            if self._ends[place[0]].has_variables
        }

    def _topics_of(self, place: Place) -> set[str]:
        """The topics on which an out-port may be."""
        name, port = place
        places = self._ends[name].producers if name in self._ends else ()
        return {topic for each, topics in places if each.port == port for topic in topics}

    def stale(self) -> dict[str, dict[str, str]]:
        """List the nodelets that receive another individual than they remember.

        Returns for each its ports that share the variables, with their topics.
        """
        found: dict[str, dict[str, str]] = {}
        wrong = [each for each in self.all_mismatches if self._ends[each[2].key].has_variables]
        if not wrong:
            return found
        lasting = {(topic, *consumer[:2]) for topic, _, consumer in self.forgetful.all_mismatches}
        for topic, _, consumer in wrong:
            if (topic, *consumer[:2]) not in lasting:
                topics = self.records[consumer.nodelet].topics
                ports = {each: topics.get(each, "") for each in self.ports_of(consumer)}
                found.setdefault(consumer.nodelet, {}).update(ports)
        return found


def wires_of(claims: Iterable[Claim]) -> set[Wire]:
    """List the connections that claims need."""
    return {
        (name, port, topic)
        for claim in claims
        for name, topics in claim.wiring.items()
        for port, topic in topics.items()
    }


def _client(claim: Claim) -> Ends:
    client = Consumer("", claim.claim_id, claim.demand, claim.claim_id)
    return Ends(claim.claim_id, consumers=((client, (claim.topic,)),))


def _together(producers: Iterable[Producer]) -> list[tuple[Sent, ...]]:
    """List the streams that may be on a topic together."""
    by_source: dict[Place, dict[Producer, None]] = {}
    for each in producers:
        by_source.setdefault((each.nodelet, each.port), {})[each] = None
    if math.prod(map(len, by_source.values())) > _MOST_POSSIBILITIES:
        return [_UNKNOWN]
    return [
        tuple({(each.tags, each.datatype): None for each in combination if not each.is_unbound})
        for combination in itertools.product(*by_source.values())
    ]


def _bound(pattern: Producer, ways: Sequence[Way]) -> Producer:
    is_open = any(not tag.substitute(way).is_ground for way in ways[:1] for tag in pattern.tags)
    return pattern._replace(tags=supplied(pattern.tags, ways), is_unbound=is_open)


def _live(record: Record) -> list[Live]:
    """List the tagged out-ports of a nodelet; an external node may not have made each."""
    seen = {port.name: port.datatype for port in record.ports}
    return [
        Live(
            record.topics.get(port.name, ""),
            port.name,
            record.name,
            record.label,
            seen.get(port.name) or port.datatype,
            port.rate,
            port.latency,
        )
        for port in record.declared
        if port.direction == OUT and port.tags and (port.name in seen or not record.is_described)
    ]


def _is_at(end: Producer | Consumer, name: str, config: Config, topic: str) -> bool:
    return end.nodelet == name and config.get(end.port) == topic
