# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Streams: which ones exist, and what feeds them."""

from __future__ import annotations

from math import inf
from typing import AbstractSet, Dict, Iterable, List, Sequence, Set, Tuple

from dyknow.manager.claims.bound_tags import Inlet, Way, supplied, ways_to_bind
from dyknow.manager.claims.topology import Topology
from dyknow.manager.planning.problem import Live, TaggedStream
from dyknow.manager.planning.supply import Demand
from dyknow.manager.record import Record, ports_on
from dyknow.manager.specifications.tags import Subsumption, Term, read_tags
from dyknow.model.graph import State
from dyknow.model.transformation import IN, OUT, Transformation


def live_streams(
    records: Iterable[Record],
    published: Iterable[Transformation],
    topology: Topology,
    ontology: Subsumption,
    unhealthy: AbstractSet[str] = frozenset(),
) -> List[TaggedStream]:
    """List the streams that a plan can use as they are.

    A nodelet's out-ports supply their tags only while the nodelet runs and each of its tagged
    in-ports is connected to a stream that satisfies it: a detector without input supplies nothing.
    These streams bind the nodelet's variables. What a stream states of its latency adds to that of
    the latest one that feeds its nodelet; one that states no rate is as fast as the slowest one.

    Args:
        records: the nodelets of the graph.
        published: transformations of type topic whose topic has a publisher.
        topology: all publishers of each topic: only the tags that hold for all of them count.
        ontology: what is a kind of what.
        unhealthy: nodelets that are not to be relied on.
    """
    streams: List[TaggedStream] = []
    on_topic: Dict[str, Tuple[Tuple[Term, ...], str]] = {}  # tags and type
    latencies: Dict[str, float] = {}
    rates: Dict[str, float] = {}  # infinite if none is stated

    def supply(stream: Live, tags: Tuple[Term, ...]) -> None:
        if stream.topic:
            tags = topology.common_tags(stream.topic, tags)
            known, _ = on_topic.get(stream.topic, ((), ""))
            on_topic[stream.topic] = (known + tags, stream.datatype)
            latencies[stream.topic] = max(stream.latency, latencies.get(stream.topic, 0.0))
            rates[stream.topic] = max(stream.rate or inf, rates.get(stream.topic, 0.0))
        streams.append((stream, tags))

    def ways(record: Record) -> List[Way]:
        """Ways to bind a nodelet's variables; none while an in-port is not fed."""
        inlets = [
            Inlet(demand, (on_topic.get(record.topics.get(port, ""), ((), "")),))
            for port, demand in _demands(record)
        ]
        return ways_to_bind([record.given], inlets, ontology)

    for each in published:
        port = each.ports[0]
        stream = Live(each.source, "", "", each.label, port.datatype, port.rate, port.latency)
        supply(stream, read_tags(port.tags))
    waiting = [
        record
        for record in records
        if record.state is State.RUNNING
        and record.transformation is not None
        and record.name not in unhealthy
    ]
    progress = True
    while progress:
        progress = False
        for record in list(waiting):
            found = ways(record)
            if found:
                waiting.remove(record)
                progress = True
                fed = [record.topics.get(port, "") for port, _ in _demands(record)]
                begun = max([latencies.get(topic, 0.0) for topic in fed], default=0.0)
                slowest = min([rates.get(topic, inf) for topic in fed], default=inf)
                for stream, tags in _outputs(record):
                    latency = round(begun + stream.latency, 6)
                    rate = stream.rate or (slowest if slowest < inf else 0.0)
                    supply(stream._replace(latency=latency, rate=rate), supplied(tags, found))
    return streams


def _demands(record: Record) -> List[Tuple[str, Demand]]:
    """List the tagged in-ports of a nodelet, each with what it demands."""
    assert record.transformation is not None
    return [
        (port.name, Demand(frozenset(tags), port.datatype))
        for port in record.transformation.ports
        for tags in [read_tags(port.tags)]
        if port.direction == IN and tags
    ]


def _outputs(record: Record) -> List[TaggedStream]:
    assert record.transformation is not None
    seen = {port.name: port.datatype for port in record.ports}
    found = []
    for port in record.transformation.ports:
        tags = read_tags(port.tags)
        is_there = port.name in seen or not record.is_described
        if port.direction == OUT and tags and is_there:
            stream = Live(
                record.topics.get(port.name, ""),
                port.name,
                record.name,
                record.transformation.label,
                seen.get(port.name) or port.datatype,
                port.rate,
                port.latency,
            )
            found.append((stream, tags))
    return found


def with_feeders(
    records: Sequence[Record],
    ordinary: AbstractSet[str],
    wiring: Dict[str, Dict[str, str]],
    sources: Set[str],
    reused: Set[str],
) -> None:
    """Add everything that feeds the nodelets which are used as they are: the stream needs it too.

    Args:
        records: the nodelets of the graph.
        ordinary: topics on which ordinary nodes publish, perhaps besides nodelets.
        wiring: for each nodelet of the stream the topics that its ports need; added to.
        sources: topics of ordinary nodes; added to.
        reused: names of nodelets that existed before; added to.
    """
    by_name = {record.name: record for record in records}
    waiting = sorted(name for name in reused if name in wiring)
    while waiting:
        name = waiting.pop()
        record = by_name.get(name)
        if record is None or record.transformation is None:
            continue
        for port in record.transformation.ports:
            topic = record.topics.get(port.name, "")
            if port.direction != IN or not port.tags or not topic:
                continue
            wiring[name][port.name] = topic
            publishers = _publishers(records, topic)
            if not publishers or topic in ordinary:
                sources.add(topic)
            for publisher, out_port in publishers:
                if publisher not in wiring:
                    waiting.append(publisher)
                    reused.add(publisher)
                wiring.setdefault(publisher, {})[out_port] = topic


def _publishers(records: Sequence[Record], topic: str) -> List[Tuple[str, str]]:
    return [
        (record.name, port)
        for record in records
        if record.state is State.RUNNING and record.transformation is not None
        for port in ports_on(record, OUT, topic)
    ]
