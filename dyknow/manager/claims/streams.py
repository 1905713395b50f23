"""Which streams are there now, and what they are about.

A nodelet's out-ports supply their tags only while the nodelet runs and each of its tagged in-ports
is connected to a stream that satisfies it: a detector that nobody feeds supplies nothing.
"""

from __future__ import annotations

from typing import AbstractSet, Iterable, List, Tuple

from dyknow.manager.claims.topology import Topology
from dyknow.manager.planning.problem import Live
from dyknow.manager.planning.supply import Demand, Supply
from dyknow.manager.record import Record
from dyknow.manager.specifications.tags import Subsumption, Term, read_tags
from dyknow.model.graph import State
from dyknow.model.transformation import IN, OUT, Transformation

Stream = Tuple[Live, Tuple[Term, ...]]


def live_streams(
    records: Iterable[Record],
    published: Iterable[Transformation],
    topology: Topology,
    ontology: Subsumption,
    unhealthy: AbstractSet[str] = frozenset(),
) -> List[Stream]:
    """List the streams that a plan can use as they are.

    Args:
        records: the nodelets of the graph.
        published: transformations of type topic whose topic has a publisher.
        topology: knows who else sends on a topic: a stream is only what holds for all of them.
        ontology: what is a kind of what.
        unhealthy: nodelets that are not to be relied on.
    """
    streams: List[Stream] = []
    on_topic: Supply[str] = Supply(ontology)

    def supply(stream: Live, tags: Tuple[Term, ...]) -> None:
        if stream.topic:
            tags = topology.common_tags(stream.topic, tags)
        streams.append((stream, tags))
        if stream.topic:
            on_topic.add(stream.topic, tags, stream.datatype)

    for each in published:
        port = each.ports[0]
        supply(Live(each.source, "", "", each.label, port.datatype), read_tags(port.tags))
    waiting = [
        record
        for record in records
        if record.state is State.RUNNING
        and record.transformation is not None
        and record.name not in unhealthy
    ]
    fed = True
    while fed:
        fed = False
        for record in list(waiting):
            if _is_fed(record, on_topic):
                waiting.remove(record)
                fed = True
                for stream, tags in _outputs(record):
                    supply(stream, tags)
    return streams


def _is_fed(record: Record, on_topic: Supply[str]) -> bool:
    assert record.transformation is not None
    for port in record.transformation.ports:
        tags = read_tags(port.tags)
        if port.direction == IN and tags:
            topic = record.topics.get(port.name, "")
            demand = Demand(frozenset(tags), port.datatype)
            if not topic or topic not in on_topic.suppliers(demand):
                return False
    return True


def _outputs(record: Record) -> List[Stream]:
    assert record.transformation is not None
    real = {port.name: port.datatype for port in record.ports}
    found = []
    for port in record.transformation.ports:
        tags = read_tags(port.tags)
        if port.direction == OUT and tags:
            stream = Live(
                record.topics.get(port.name, ""),
                port.name,
                record.name,
                record.transformation.label,
                real.get(port.name) or port.datatype,
            )
            found.append((stream, tags))
    return found
