# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The topics on which the ports of nodelets meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Iterable, List, Sequence, Tuple

from dyknow.datatypes import ANY
from dyknow.model.graph import NodeletStatus, PortRef, PortState
from dyknow.model.transformation import OUT
from dyknow.wiring.ports import by_name


@dataclass(frozen=True)
class Topic:
    """A topic that ports are connected to.

    Attributes:
        name: global name.
        datatype: ROS type, empty when no port knows it.
        sources: out-ports that publish on it, sorted.
        targets: in-ports that receive from it, sorted.
        tags: of the out-ports, sorted.
    """

    name: str
    datatype: str
    sources: Tuple[PortRef, ...]
    targets: Tuple[PortRef, ...]
    tags: Tuple[str, ...] = ()


def topics_of(nodelets: Iterable[NodeletStatus]) -> List[Topic]:
    """List the topics that nodelets are connected to, by name."""
    ends: Dict[str, List[Tuple[PortRef, PortState]]] = {}
    for nodelet in sorted(nodelets, key=lambda each: each.name):
        for port in by_name(nodelet.ports):
            if port.topic:
                ends.setdefault(port.topic, []).append((PortRef(nodelet.name, port.name), port))
    return [_topic(name, ends[name]) for name in sorted(ends)]


def _topic(name: str, ends: Sequence[Tuple[PortRef, PortState]]) -> Topic:
    types = (port.datatype for _, port in ends if port.datatype not in ANY)
    out_ports = [port for _, port in ends if port.direction == OUT]
    return Topic(
        name,
        next(types, ""),
        tuple(ref for ref, port in ends if port.direction == OUT),
        tuple(ref for ref, port in ends if port.direction != OUT),
        tuple(sorted({tag for port in out_ports for tag in port.tags})),
    )
