# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The ends of streams: what each port of a nodelet sends, or has to receive."""

from __future__ import annotations

from typing import FrozenSet, List, NamedTuple, Tuple

from dyknow.manager.claims.bound_tags import Way
from dyknow.manager.claims.relay import is_relay
from dyknow.manager.planning.supply import Demand
from dyknow.manager.record import Record
from dyknow.manager.specifications.tags import NO_BINDINGS, Term, read_tags
from dyknow.model.transformation import OUT, Port


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

    @property
    def variables(self) -> FrozenSet[str]:
        """Variables of its demand, which the stream binds."""
        return frozenset(name for tag in self.demand.tags for name in tag.variables)


class NodeletEnds(NamedTuple):
    """What a nodelet contributes to a topology, each end with the topics on which it is.

    The tags are those that the nodelet was made with, whatever the library says now.

    Attributes:
        is_relay: whether it sends what it receives.
        producers: its out-ports.
        consumers: its tagged in-ports.
        given: what its variables stand for in any case.
        listening: its in-ports with variables, and their topics.
        heard: what its variables stood for in what it received there, in each way.
        has_variables: whether what it receives says what else it may receive, or what it sends.
        is_by_hand: whether it was not made for claims: anybody may have connected it to anything.
    """

    is_relay: bool
    producers: Tuple[Tuple[Producer, Tuple[str, ...]], ...]
    consumers: Tuple[Tuple[Consumer, Tuple[str, ...]], ...]
    given: Way = NO_BINDINGS
    listening: Tuple[Tuple[str, Tuple[str, ...]], ...] = ()
    heard: Tuple[Way, ...] = ()
    has_variables: bool = False
    is_by_hand: bool = False

    @property
    def known(self) -> Tuple[Way, ...]:
        """What its variables stand for before it receives anything more, in each way."""
        return self.heard or (self.given,)


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
    listening = tuple((each.port, where) for each, where in consumers if each.variables)
    is_as_then = record.heard.topics == listening
    return NodeletEnds(
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
