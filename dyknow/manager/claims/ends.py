# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The ends of streams: what each port of a nodelet sends, or has to receive.

A relay brings a stream to where a client listens. It is made where the stream itself has to stay
on its topic: an ordinary node publishes it, or other clients listen there.

Variables are bound by the parameters of a nodelet's spawn, and by the streams at its in-ports. A
stream with several tags may bind a variable in several ways, and all of them hold for the messages
of the nodelet. In-ports that contradict each other leave no way.
"""

from __future__ import annotations

import itertools
from typing import Iterable, Mapping, NamedTuple, Sequence, Tuple

from dyknow.datatypes import ANY
from dyknow.errors import SpawnFailed
from dyknow.manager.planning.problem import Demand, ways_to_meet
from dyknow.manager.record import Record
from dyknow.manager.specifications.tags import NO_BINDINGS, Subsumption, Term, read_tags
from dyknow.model.graph import NodeletStatus
from dyknow.model.transformation import IN, OUT, Parameter, Port, Transformation

#: The cost of a relay: the default cost of transformations.
RELAY_COST = 1
#: Labels of relays begin with this.
_PREFIX = "relay of "
#: Ways that are followed; beyond, less is supplied than could be.
_MOST_WAYS = 64


def relay(topic: str, datatype: str, tags: tuple[str, ...]) -> Transformation:
    """Describe a relay for a topic, of the same tags; its type has to be known."""
    if datatype in ANY:
        raise SpawnFailed(_PREFIX + topic, "the type of its messages is not known")
    tags = tuple(tag for tag in tags if all(term.is_ground for term in read_tags((tag,))))
    return Transformation(
        _PREFIX + topic,
        "dyknow/Relay",
        cost=RELAY_COST,
        parameters=(Parameter("datatype", "string", datatype),),
        ports=(Port("in", IN, datatype, tags), Port("out", OUT, datatype, tags)),
    )


def is_relay(transformation: Transformation | None) -> bool:
    """Whether a transformation is one of ours, not of the library."""
    return (
        transformation is not None
        and transformation.label.startswith(_PREFIX + "/")
        and transformation.source == "dyknow/Relay"
    )


def transformation_of_relay(nodelet: NodeletStatus) -> Transformation | None:
    """Return the transformation of a relay, which no library has; None for any other nodelet."""
    out = nodelet.port("out")
    if not nodelet.transformation.startswith(_PREFIX + "/") or out is None or out.datatype in ANY:
        return None
    return relay(nodelet.transformation[len(_PREFIX) :], out.datatype, out.tags)


Way = Mapping[str, str]
"""A name for each variable that is bound."""

Sent = Tuple[Tuple[Term, ...], str]
"""The tags and the ROS type of what a source sends."""


class Inlet(NamedTuple):
    """The demand of an in-port, and the streams there; all of them bind the same names."""

    demand: Demand
    sources: tuple[Sent, ...]


def ways_to_bind(
    known: Iterable[Way], inlets: Iterable[Inlet], ontology: Subsumption
) -> list[Way]:
    """List the ways in which the demand of every in-port is met; none if they contradict.

    Each starts from one that is ``known`` in any case. All bind the same variables; the order is
    deterministic.
    """
    found: list[Way] = list(known)
    for demand, sources in inlets:
        for tags, datatype in sources:
            more = (
                way
                for before in found
                for way in ways_to_meet(tags, datatype, demand, ontology, before)
            )
            found = list(_distinct(itertools.islice(more, _MOST_WAYS)))
    return found


def supplied(tags: Sequence[Term], ways: Iterable[Way]) -> tuple[Term, ...]:
    """Return the tags of an out-port in all ways; with unbound variables they supply nothing."""
    bound = [term.substitute(way) for way in ways for term in tags]
    return tuple(dict.fromkeys(term for term in bound if term.is_ground))


def _distinct(ways: Iterable[Way]) -> Iterable[Way]:
    found: dict[tuple[tuple[str, str], ...], Way] = {}
    for way in ways:
        found.setdefault(tuple(sorted(way.items())), way)
    return found.values()


class Producer(NamedTuple):
    """An out-port, or the ordinary nodes that publish on a topic.

    Attributes:
        nodelet: its name; empty for ordinary nodes.
        port: its out-port; empty for ordinary nodes.
        tags: the tags of its messages.
        datatype: ROS type of its messages.
        is_unbound: whether it sends nothing, since a variable of its tags is bound to nothing.
    """

    nodelet: str
    port: str
    tags: tuple[Term, ...] = ()
    datatype: str = ""
    is_unbound: bool = False


class Consumer(NamedTuple):
    """A tagged in-port, or the client of a claim.

    Attributes:
        nodelet: its name; empty for a client.
        port: its in-port, or the id of the claim.
        demand: the only messages that it may receive.
        ends: number of its nodelet among those whose in-ports depend on each other; else -1.
    """

    nodelet: str
    port: str
    demand: Demand
    ends: int = -1

    @property
    def variables(self) -> frozenset[str]:
        """Variables of its demand, which the stream binds."""
        return frozenset(name for tag in self.demand.tags for name in tag.variables)


class NodeletEnds(NamedTuple):
    """The ends of streams at a nodelet, each with the topics on which it is.

    The tags are those that the nodelet was made with, even if the library has changed.

    Attributes:
        name: of the nodelet.
        is_relay: whether it forwards messages.
        producers: its out-ports.
        consumers: its tagged in-ports.
        given: names that its variables stand for in any case.
        listening: its in-ports with variables, and their topics.
        heard: names that its variables stood for in the messages received there, in each way.
        has_variables: whether its tags have variables, which its in-ports bind.
        is_by_hand: whether it was not made for claims: people may have connected it to anything.
    """

    name: str
    is_relay: bool
    producers: tuple[tuple[Producer, tuple[str, ...]], ...]
    consumers: tuple[tuple[Consumer, tuple[str, ...]], ...]
    given: Way = NO_BINDINGS
    listening: tuple[tuple[str, tuple[str, ...]], ...] = ()
    heard: tuple[Way, ...] = ()
    has_variables: bool = False
    is_by_hand: bool = False

    @property
    def known(self) -> tuple[Way, ...]:
        """Names that its variables stand for before it receives anything more, in each way."""
        return self.heard or (self.given,)


def ends_of(record: Record) -> NodeletEnds:
    """Read the ends of a nodelet."""
    producers: list[tuple[Producer, tuple[str, ...]]] = []
    consumers: list[tuple[Consumer, tuple[str, ...]]] = []
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
    listening = tuple((each.port, where) for each, where in consumers if each.variables)
    is_as_then = record.heard.topics == listening
    return NodeletEnds(
        record.name,
        is_relay(record.transformation),
        tuple(producers),
        tuple(consumers),
        record.given,
        listening,
        tuple(map(dict, record.heard.ways)) if is_as_then else (),
        bool(record.given or listening)
        or any(not tag.is_ground for producer, _ in producers for tag in producer.tags),
        not record.claimed,
    )


def _ports(record: Record) -> list[Port]:
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
