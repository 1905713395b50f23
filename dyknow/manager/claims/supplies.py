# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The supplies that plans count on: streams, their feeders, and nodelets to connect elsewhere."""

from __future__ import annotations

from math import inf
from typing import AbstractSet, Iterable, Mapping, NamedTuple, Sequence, Tuple

from dyknow.errors import UnknownTransformation
from dyknow.manager.claims.ends import Inlet, Way, is_relay, supplied, ways_to_bind
from dyknow.manager.claims.topology import Topology
from dyknow.manager.library import Library
from dyknow.manager.planning.problem import Demand, Live, New, Plan, PlanStep, TaggedStream
from dyknow.manager.record import Record, ports_on
from dyknow.manager.specifications.tags import Bindings, Subsumption, Term, read_tags
from dyknow.model.graph import State
from dyknow.model.transformation import IN, OUT, Transformation

Instance = Tuple[str, Bindings]
"""The label of a transformation and what its variables stand for: what a plan needs once."""


class OwnNodelet(NamedTuple):
    """A healthy nodelet that can be connected elsewhere for a claim.

    Attributes:
        name: its name.
        label: its transformation.
        kept: names that its variables have to stand for wherever it is connected.
        present: names that they stand for now, as far as known.
    """

    name: str
    label: str
    kept: Bindings = ()
    present: Bindings = ()


def instance_of(part: New | PlanStep) -> Instance:
    """Return the instance that a part of a plan belongs to."""
    label = part.label if isinstance(part, New) else part.action.label
    return label, part.bindings


def assigned(plan: Plan, own: Sequence[OwnNodelet], ontology: Subsumption) -> dict[Instance, str]:
    """Choose nodelets for the steps of a plan, by instance; the other instances need new ones.

    The preferred ones come first in ``own``. Those that stay as they are take precedence, since
    nothing that they supply changes.
    """
    left = list(own)
    found: dict[Instance, str] = {}
    for stays in (True, False):
        for instance in map(instance_of, plan.steps):
            if instance in found:
                continue
            for each in left:
                bound = each.present if stays else each.kept
                if stays and not bound:
                    continue
                if each.label == instance[0] and _agree(bound, instance[1], ontology):
                    found[instance] = each.name
                    left.remove(each)
                    break
    return found


def _agree(some: Bindings, all_: Bindings, ontology: Subsumption) -> bool:
    """Whether all that is bound in ``some`` stands for the same individual in ``all_``."""
    known = {variable: ontology.canonical(name) for variable, name in all_}
    return all(known.get(variable) == ontology.canonical(name) for variable, name in some)


def live_streams(
    records: Iterable[Record],
    published: Iterable[Transformation],
    topology: Topology,
    ontology: Subsumption,
) -> list[TaggedStream]:
    """List the streams that a plan can use as they are.

    A nodelet's out-ports supply their tags only while each of its tagged in-ports is connected to
    a stream that satisfies it. These streams bind the nodelet's variables. The stated latency of a
    stream adds to that of the latest one that feeds its nodelet; one that states no rate is as
    fast as the slowest one. Only tags that hold for all publishers of a topic count.
    """
    streams: list[TaggedStream] = []
    on_topic: dict[str, tuple[tuple[Term, ...], str]] = {}  # tags and type
    latencies: dict[str, float] = {}
    rates: dict[str, float] = {}  # infinite if none is stated

    def supply(stream: Live, tags: tuple[Term, ...]) -> None:
        if stream.topic:
            tags = topology.common_tags(stream.topic, tags)
            known, _ = on_topic.get(stream.topic, ((), ""))
            on_topic[stream.topic] = (known + tags, stream.datatype)
            latencies[stream.topic] = max(stream.latency, latencies.get(stream.topic, 0.0))
            rates[stream.topic] = max(stream.rate or inf, rates.get(stream.topic, 0.0))
        streams.append((stream, tags))

    for each in published:
        port = each.ports[0]
        stream = Live(each.source, "", "", each.label, port.datatype, port.rate, port.latency)
        supply(stream, read_tags(port.tags))
    waiting = [each for each in records if each.state is State.RUNNING and each.transformation]
    progress = True
    while progress:
        progress = False
        for record in list(waiting):
            demands = _demands(record)
            fed = [record.topics.get(port, "") for port, _ in demands]
            inlets = [
                Inlet(demand, (on_topic.get(topic, ((), "")),))
                for topic, (_, demand) in zip(fed, demands)
            ]
            ways: list[Way] = ways_to_bind([record.given], inlets, ontology)
            if not ways:
                continue  # an in-port is not fed
            waiting.remove(record)
            progress = True
            begun = max([latencies.get(topic, 0.0) for topic in fed], default=0.0)
            slowest = min([rates.get(topic, inf) for topic in fed], default=inf)
            for stream, tags in _outputs(record):
                latency = round(begun + stream.latency, 6)
                rate = stream.rate or (slowest if slowest < inf else 0.0)
                supply(stream._replace(latency=latency, rate=rate), supplied(tags, ways))
    return streams


def _demands(record: Record) -> list[tuple[str, Demand]]:
    """List the tagged in-ports of a nodelet, each with its demand."""
    assert record.transformation is not None
    return [
        (port.name, Demand(frozenset(read_tags(port.tags)), port.datatype))
        for port in record.transformation.ports
        if port.direction == IN and port.tags
    ]


def _outputs(record: Record) -> list[TaggedStream]:
    assert record.transformation is not None
    seen = {port.name: port.datatype for port in record.ports}
    found = []
    for port in record.transformation.ports:
        is_there = port.name in seen or not record.is_described
        if port.direction == OUT and port.tags and is_there:
            stream = Live(
                record.topics.get(port.name, ""),
                port.name,
                record.name,
                record.label,
                seen.get(port.name) or port.datatype,
                port.rate,
                port.latency,
            )
            found.append((stream, read_tags(port.tags)))
    return found


def with_upstream(
    records: Mapping[str, Record], ordinary: AbstractSet[str], nodelets: Iterable[str]
) -> tuple[dict[str, dict[str, str]], set[str]]:
    """Find everything that feeds nodelets.

    Returns these nodelets and all upstream of them, with the topics of the ports between them, and
    the topics of ordinary nodes (``ordinary`` ones even beside nodelets).
    """
    wiring: dict[str, dict[str, str]] = {name: {} for name in sorted(nodelets)}
    sources: set[str] = set()
    waiting = list(wiring)
    while waiting:
        name = waiting.pop()
        record = records.get(name)
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
                    wiring[publisher] = {}
                    waiting.append(publisher)
                wiring[publisher][out_port] = topic
    return wiring, sources


def _publishers(records: Mapping[str, Record], topic: str) -> list[tuple[str, str]]:
    return [
        (record.name, port)
        for record in records.values()
        if record.state is State.RUNNING and record.transformation is not None
        for port in ports_on(record, OUT, topic)
    ]


def is_current(library: Library, record: Record) -> bool:
    """Whether the library still has a nodelet's transformation, perhaps in a newer version."""
    if is_relay(record.transformation):
        return True
    try:
        library.get(record.label)
    except UnknownTransformation:
        return False
    return True
