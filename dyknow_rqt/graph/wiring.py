# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Decides which ports fit together, over which topic, and makes the changes that connect them."""

from __future__ import annotations

from typing import Iterator, List, Tuple

from dyknow import names
from dyknow.datatypes import types_fit
from dyknow.model.graph import PortRef, PortState
from dyknow.model.transformation import IN, OUT
from dyknow.wiring import ports
from dyknow.wiring.ports import CannotConnect
from dyknow_rqt.graph.changes import Rewire
from dyknow_rqt.graph.snapshot import Snapshot


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


def topics_for(snapshot: Snapshot, ref: PortRef) -> List[str]:
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
    published = snapshot.taken.union(*(node.publishes for node in snapshot.nodes))
    known = [port for nodelet in snapshot.nodelets for port in nodelet.ports]
    published |= {port.topic for port in known if port.direction == OUT}
    taken = {port.topic for port in known}
    return ports.choose_topic(source.nodelet, out_port, in_port, published, taken)


def connect(snapshot: Snapshot, one: PortRef, other: PortRef) -> Rewire:
    """Connect two ports, in any order, over a topic that is chosen, or raise CannotConnect."""
    port = snapshot.port(one)
    source, sink = (other, one) if port is not None and port.direction == IN else (one, other)
    topic = choose_topic(snapshot, source, sink)
    return rewire(snapshot, ((source, topic), (sink, topic)), f"connect {source} with {sink}")


def connect_topic(snapshot: Snapshot, ref: PortRef, topic: str) -> Rewire:
    """Connect a port to a named topic.

    Raises:
        CannotConnect: the graph knows another type of the topic, or there is no such port.
        InvalidName: it is not the name of a topic.
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


def disconnect(snapshot: Snapshot, refs: Tuple[PortRef, ...]) -> Rewire:
    what = str(refs[0]) if len(refs) == 1 else f"{len(refs)} ports"
    return rewire(snapshot, tuple((ref, "") for ref in refs), f"disconnect {what}")


def rewire(snapshot: Snapshot, topics: Tuple[Tuple[PortRef, str], ...], text: str) -> Rewire:
    """Change connections; ports that are already connected as wanted are left out."""
    wanted, now = [], []
    for ref, topic in topics:
        port = snapshot.port(ref)
        if port is None or port.topic != topic:
            wanted.append((ref, topic))
            now.append((ref, port.topic if port is not None else ""))
    return Rewire(tuple(wanted), text, tuple(now))
