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
import json
from typing import Collection, Iterable, Mapping, NamedTuple, Sequence, Tuple

from dyknow.datatypes import ANY
from dyknow.errors import SpawnFailed
from dyknow.manager.claim import STREAM
from dyknow.manager.planning.problem import Demand, ways_to_meet
from dyknow.manager.record import Record
from dyknow.manager.specifications.tags import NO_BINDINGS, Subsumption, Term, read_tags
from dyknow.model.graph import NodeletStatus
from dyknow.model.transformation import (
    FORMULA_CLASS,
    IN,
    OUT,
    VERDICT,
    Parameter,
    Port,
    Transformation,
)

#: The cost of a relay: the default cost of transformations.
RELAY_COST = 1
#: Labels of relays, and of monitors of streams, begin so.
_PREFIX = "relay of "
_MONITOR = "monitor of "
#: Out-port of a monitor.
VERDICTS = "holds"
#: Seconds for which the states of a monitor stay open. Those of a stream that flows close with its
#: next message: so one that bears older stamps is judged, and silence is seen that much later.
_DELAY = "1.0"
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


def monitor(topic: str, datatype: str) -> Transformation:
    """Describe the nodelet that evaluates a formula about a topic; see ``monitored``."""
    if datatype in ANY:
        raise SpawnFailed(_MONITOR + topic, "the type of its messages is not known")
    ports = (Port(STREAM, IN, datatype), Port(VERDICTS, OUT, VERDICT))
    return Transformation(_MONITOR + topic, FORMULA_CLASS, cost=0, ports=ports)


def monitored(formula: str, datatype: str) -> tuple[Parameter, ...]:
    """Return the parameters that a monitor is given."""
    datatypes = json.dumps({STREAM: datatype})
    return (
        Parameter("formula", "string", formula),
        Parameter("datatypes", "yaml", datatypes),
        Parameter("delay", "double", _DELAY),
    )


def is_monitor(transformation: Transformation | None) -> bool:
    """Whether a transformation is that of a monitor, which no library has."""
    return transformation is not None and transformation.label.startswith(_MONITOR + "/")


def transformation_made_here(nodelet: NodeletStatus) -> Transformation | None:
    """Return the transformation of a relay or monitor, which no library has; else None."""
    stream = nodelet.port(STREAM)
    if nodelet.transformation.startswith(_MONITOR + "/") and stream is not None:
        return monitor(nodelet.transformation[len(_MONITOR) :], stream.datatype)
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
            distinct = {tuple(sorted(e.items())): e for e in itertools.islice(more, _MOST_WAYS)}
            found = list(distinct.values())
    return found


def supplied(tags: Sequence[Term], ways: Iterable[Way]) -> tuple[Term, ...]:
    """Return the tags of an out-port in all ways; with unbound variables they supply nothing."""
    bound = [term.substitute(way) for way in ways for term in tags]
    return tuple(dict.fromkeys(term for term in bound if term.is_ground))


class Producer(NamedTuple):
    """An out-port, or the ordinary nodes that publish on a topic."""

    nodelet: str  # its name; empty for ordinary nodes
    port: str  # its out-port; empty for ordinary nodes
    tags: tuple[Term, ...] = ()  # the tags of its messages
    datatype: str = ""  # ROS type of its messages
    #: Whether it sends nothing, since a variable of its tags is bound to nothing.
    is_unbound: bool = False
    key: str = ""  # of the ends that it belongs to


class Consumer(NamedTuple):
    """A tagged in-port, or the client of a claim."""

    nodelet: str  # its name; empty for a client
    port: str  # its in-port, or the id of the claim
    demand: Demand  # the only messages that it may receive
    key: str  # of the ends that it belongs to

    @property
    def variables(self) -> frozenset[str]:
        """Variables of its demand, which the stream binds."""
        return frozenset([name for tag in self.demand.tags for name in tag.variables])


Where = Tuple[str, ...]
"""The topics on which a port may be."""
Late = Mapping[Tuple[str, str], Collection[str]]
"""Topics on which late connections may put ports, by nodelet and port."""
NOWHERE: Late = {}
"""No connection is late."""


class Ends(NamedTuple):
    """The ends of streams at a nodelet or a client.

    A port is on each topic on which it may be: where it was seen last, where it should be, and
    where a connection without an answer may have put it. The tags are those that the nodelet was
    made with, even if the library has changed.
    """

    key: str  # name of the nodelet, unless it is as it would be then; else a text that is no name
    producers: tuple[tuple[Producer, Where], ...] = ()  # the out-ports
    consumers: tuple[tuple[Consumer, Where], ...] = ()  # the tagged in-ports
    is_relay: bool = False  # whether it forwards messages
    given: Way = NO_BINDINGS  # names that its variables stand for in any case
    listening: tuple[tuple[str, Where], ...] = ()  # its in-ports with variables, and their topics
    #: Names that its variables stood for in the messages received there, in each way.
    heard: tuple[Way, ...] = ()
    has_variables: bool = False  # whether its tags have variables, which its in-ports bind
    #: Whether it was not made for claims: people may have connected it to anything.
    is_by_hand: bool = False

    @property
    def known(self) -> tuple[Way, ...]:
        """Names that its variables stand for before it receives anything more, in each way."""
        return self.heard or (self.given,)


def sent_on(topic: str, described: Iterable[Transformation]) -> Producer:
    """Return the ordinary nodes that publish on a topic, as the library describes them."""
    ports = [each.ports[0] for each in described]
    tags = tuple([term for port in ports for term in read_tags(port.tags)])
    datatype = next((port.datatype for port in ports if port.datatype), "")
    return Producer("", "", tags, datatype)


def ends_of(record: Record, late: Late = NOWHERE, key: str = "", is_planned: bool = False) -> Ends:
    """Read the ends of a nodelet, by default under its name.

    With ``is_planned`` its ports are where they should be, not where they were seen.
    """
    name, key = record.name, key or record.name
    producers: list[tuple[Producer, Where]] = []
    consumers: list[tuple[Consumer, Where]] = []
    listening: list[tuple[str, Where]] = []
    has_variables = bool(record.given)
    seen = {port.name: port for port in record.ports}
    ports = {port.name: port for port in record.declared}
    for each in record.ports:
        ports.setdefault(each.name, Port(each.name, each.direction, each.datatype))
    for port in ports.values():
        found = seen.get(port.name)
        is_typed = found is not None and found.datatype not in ANY
        datatype = found.datatype if found is not None and is_typed else port.datatype
        tags = read_tags(port.tags)
        topics = {record.topics.get(port.name, "")}
        if found is not None and not (is_planned and port.name in record.topics):
            topics.add(found.topic)
        topics.discard("")
        where = tuple(sorted(topics.union(late.get((name, port.name), ())) - {""}))
        is_open = "?" in "".join(port.tags)
        if port.direction == OUT:
            producers.append((Producer(name, port.name, tags, datatype, key=key), where))
        elif tags:
            demand = Demand(frozenset(tags), datatype)
            consumers.append((Consumer(name, port.name, demand, key), where))
            if is_open:
                listening.append((port.name, tuple(sorted(topics))))
        has_variables = has_variables or is_open
    is_as_then = record.heard.topics == tuple(listening)
    return Ends(
        key,
        tuple(producers),
        tuple(consumers),
        is_relay(record.transformation),
        record.given,
        tuple(listening),
        tuple(map(dict, record.heard.ways)) if is_as_then else (),
        has_variables,
        not record.claimed,
    )
