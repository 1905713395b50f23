# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Decides which ports fit together, over which topic, and makes the changes that connect them."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import partial
from typing import Iterator, Mapping, Sequence

from dyknow import names
from dyknow.datatypes import types_fit
from dyknow.manager.steps import ReversibleStep, check_connected
from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import PortRef, PortState, SpawnRequest
from dyknow.model.transformation import IN, OUT, Port, Transformation
from dyknow.wiring import ports
from dyknow.wiring.ports import CannotConnect
from dyknow_rqt.graph.changes import Change, Present, spawn
from dyknow_rqt.graph.figure import Edge, edge_refs
from dyknow_rqt.graph.snapshot import Snapshot


@dataclass(frozen=True)
class Rewire(Change):
    """Connects ports of any number of nodelets, all of them or none, each to a topic.

    An empty topic disconnects a port; ``expected`` has their topics before the change.
    """

    topics: tuple[tuple[PortRef, str], ...] = ()
    expected: tuple[tuple[PortRef, str], ...] = ()

    @property
    def replaced(self) -> str:
        """The connections that end by it, in words; empty if there are none."""
        ends = dict(self.expected)
        lost = [f"{ends[ref]} at {ref}" for ref, topic in self.topics if ends.get(ref) and topic]
        return f"replaces {', '.join(lost)}" if lost else ""


def _by_nodelet(topics: Sequence[tuple[PortRef, str]]) -> list[tuple[str, dict[str, str]]]:
    configs: dict[str, dict[str, str]] = {}
    for ref, topic in topics:
        configs.setdefault(ref.nodelet, {})[ref.port] = topic
    return list(configs.items())


def _check(client: BaseManagerClient, topics: Sequence[tuple[PortRef, str]]) -> None:
    """Ask the proxies: the window's snapshot may be older than its own last change."""
    for nodelet, config in _by_nodelet(topics):
        check_connected(client, nodelet, config)


def fit(one: PortState, other: PortState) -> bool:
    """Whether a stream can lead from one of the ports to the other."""
    return one.direction != other.direction and types_fit(one.datatype, other.datatype)


def partners(snapshot: Snapshot, ref: PortRef) -> Iterator[PortRef]:
    """Ports that a port can be connected with, by nodelet and in their order."""
    port = snapshot.port(ref)
    if port is not None:
        for nodelet in snapshot.nodelets:
            for other in nodelet.ports:
                if fit(port, other):
                    yield PortRef(nodelet.name, other.name)


def topics_for(snapshot: Snapshot, ref: PortRef) -> list[str]:
    """Topics of the graph that a port can be connected to, sorted."""
    port = snapshot.port(ref)
    if port is None:
        return []
    return [
        name
        for name, topic in snapshot.topics().items()
        if types_fit(port.datatype, topic.datatype)
    ]


def choose_topic(snapshot: Snapshot, source: PortRef, sink: PortRef) -> str:
    """Choose the topic for a connection, as ``dyknow connect`` does, or raise CannotConnect."""
    out_port, in_port = snapshot.port(source), snapshot.port(sink)
    if out_port is None or in_port is None:
        raise CannotConnect(f"{source if out_port is None else sink} is gone")
    ports.check_ends(str(source), out_port, str(sink), in_port)
    return _topic_for(snapshot, source.nodelet, out_port, in_port)


def _topic_for(snapshot: Snapshot, nodelet: str, out: PortState, into: PortState) -> str:
    published = snapshot.taken.union(*(node.publishes for node in snapshot.nodes))
    known = [port for nodelet in snapshot.nodelets for port in nodelet.ports]
    published |= {port.topic for port in known if port.direction == OUT}
    taken = {port.topic for port in known}
    return ports.choose_topic(nodelet, out, into, published, taken)


def connect(snapshot: Snapshot, one: PortRef, other: PortRef) -> Rewire:
    """Connect two ports, in any order, over a topic that is chosen, or raise CannotConnect."""
    port = snapshot.port(one)
    source, sink = (other, one) if port is not None and port.direction == IN else (one, other)
    topic = choose_topic(snapshot, source, sink)
    return rewire(snapshot, ((source, topic), (sink, topic)), f"connect {source} with {sink}")


def connect_topic(snapshot: Snapshot, ref: PortRef, topic: str) -> Rewire:
    """Connect a port to a named topic.

    Raises:
        CannotConnect: the graph knows another type of the topic, or the port is unknown.
        InvalidName: the text is not the name of a topic.
    """
    port = snapshot.port(ref)
    if port is None:
        raise CannotConnect(f"{ref} is gone")
    topic = names.resolve(names.check(topic, "topic"), names.parent(ref.nodelet), ref.nodelet)
    known = snapshot.topics().get(topic)
    if known is not None and not types_fit(port.datatype, known.datatype):
        raise CannotConnect(
            f"{ref} is of type {port.datatype}, but {topic} carries {known.datatype}"
        )
    return rewire(snapshot, ((ref, topic),), f"connect {ref} to {topic}")


def disconnect(snapshot: Snapshot, refs: tuple[PortRef, ...]) -> Rewire:
    what = str(refs[0]) if len(refs) == 1 else f"{len(refs)} ports"
    return rewire(snapshot, tuple((ref, "") for ref in refs), f"disconnect {what}")


def rewire(snapshot: Snapshot, topics: tuple[tuple[PortRef, str], ...], text: str) -> Rewire:
    """Change connections; ports that are already connected as wanted are left out."""
    wanted, now = [], []
    for ref, topic in topics:
        port = snapshot.port(ref)
        if port is None or port.topic != topic:
            wanted.append((ref, topic))
            now.append((ref, port.topic if port is not None else ""))

    def steps(present: Present) -> Sequence[ReversibleStep]:
        client = present.client
        do, undo = (partial(client.connect, _by_nodelet(each)) for each in (wanted, now))
        return [ReversibleStep(text, "", do, undo, partial(_check, client, wanted))]

    return Rewire(text, steps, lambda client: _check(client, now), tuple(wanted), tuple(now))


def splice(snapshot: Snapshot, ref: PortRef, edge: Edge) -> Rewire:
    """Lead an arrow through the nodelet of a port, or raise CannotConnect.

    The nodelet receives the arrow's messages, and its own go to the arrow's target.
    Where it has no free port for its other side, or the arrow ends at no port that is known, as
    between closed boxes, only the port is connected to the arrow.
    """
    port, refs = snapshot.port(ref), edge_refs(edge)
    ends = {end.nodelet: end for end in refs if snapshot.port(end) is not None}
    if port is None:
        raise CannotConnect(f"{ref} is gone")
    if ref.nodelet in ends:
        raise CannotConnect(f"{ref.nodelet} is at an end of this arrow already")
    sink = next((end for end in ends.values() if _side(snapshot, end) == IN), None)
    topic = snapshot.topics().get(edge.topic)
    here = PortState("", OUT if port.direction == IN else IN, topic.datatype if topic else "")
    if not fit(port, here):
        raise CannotConnect(
            f"{ref} is of type {port.datatype}, but {edge.topic} carries {here.datatype}"
        )
    nodelet = snapshot.nodelet(ref.nodelet)
    assert nodelet is not None
    other = replace(here, direction=port.direction)
    free = (p for p in nodelet.ports if not p.topic and p.name != ref.port and fit(p, other))
    match = next(free, None)
    if match is None or not ends:
        if port.direction == OUT and sink is not None:
            return connect(snapshot, ref, sink)
        return connect_topic(snapshot, ref, edge.topic)
    into, out = (port, match) if port.direction == IN else (match, port)
    x_in, x_out = PortRef(ref.nodelet, into.name), PortRef(ref.nodelet, out.name)
    if sink is not None:
        new = _topic_for(snapshot, ref.nodelet, out, PortState("", IN))
        moves = ((x_in, edge.topic), (x_out, new), (sink, new))
    else:
        (source,) = ends.values()
        before = snapshot.port(source)
        assert before is not None
        new = _topic_for(snapshot, source.nodelet, replace(before, topic=""), PortState("", IN))
        moves = ((source, new), (x_in, new), (x_out, edge.topic))
    return rewire(snapshot, moves, f"splice {ref.nodelet} into {edge.topic}")


def _side(snapshot: Snapshot, ref: PortRef) -> str:
    port = snapshot.port(ref)
    return port.direction if port is not None else ""


def offers(
    snapshot: Snapshot, library: Mapping[str, Transformation], ref: PortRef
) -> list[tuple[str, Port]]:
    """Find the transformations that fit a port: labels with ports, known types first."""
    start = snapshot.port(ref)
    if start is None:
        return []
    found = [
        (label, port)
        for label, each in library.items()
        for port in each.ports
        if not each.is_described and fit(start, _state(port))
    ]
    return sorted(found, key=lambda each: (each[1].datatype != start.datatype, each[0]))


def _state(port: Port) -> PortState:
    return PortState(port.name, port.direction, port.datatype)


def spawn_at(snapshot: Snapshot, ref: PortRef, label: str, port: Port, name: str) -> Change:
    """Make a nodelet whose port is connected with one that there is."""
    start, made = snapshot.port(ref), _state(port)
    if start is None:
        raise CannotConnect(f"{ref} is gone")
    if start.direction == OUT:
        topic = _topic_for(snapshot, ref.nodelet, start, made)
    else:
        topic = _topic_for(snapshot, name, made, start)
    maker = spawn(SpawnRequest(label, name, {port.name: topic}))
    wire = rewire(snapshot, ((ref, topic),), f"connect {ref} to {topic}")
    parts = [maker, wire] if wire.topics else [maker]
    parts = parts if start.direction == IN else parts[::-1]
    return Change(
        f"create {name} at {ref}",
        lambda present: [step for part in parts for step in part.steps(present)],
    )


def free_name(snapshot: Snapshot, label: str, space: str = "/") -> str:
    """A name after a label that is not taken: /camera for camera(nao1, top)."""
    wish = re.sub(r"[^A-Za-z0-9_/]+", "_", label).strip("_/") or "nodelet"
    wish = space.rstrip("/") + "/" + (wish if wish[0].isalpha() else f"n{wish}")
    name, number = wish, 2
    while snapshot.nodelet(name) is not None:
        name, number = f"{wish}_{number}", number + 1
    return name
