# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The computation graph by topics, and as text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Dict, Iterator, List, Sequence, Tuple

from dyknow.cli.views import state_of
from dyknow.model.graph import PortRef
from dyknow.model.transformation import OUT
from dyknow.wiring.ports import by_name

if TYPE_CHECKING:
    from dyknow.model.graph import Model, NodeletStatus


@dataclass(frozen=True)
class Topic:
    """A topic that ports are connected to.

    Attributes:
        name: global name.
        datatype: ROS type, empty when no port knows it.
        sources: out-ports on it, sorted.
        targets: in-ports on it, sorted.
    """

    name: str
    datatype: str
    sources: Tuple[PortRef, ...]
    targets: Tuple[PortRef, ...]


def topics_of(snapshot: Model) -> List[Topic]:
    """List the topics that nodelets are connected to, by name."""
    sources: Dict[str, List[PortRef]] = {}
    targets: Dict[str, List[PortRef]] = {}
    types: Dict[str, str] = {}
    for nodelet in sorted(snapshot.nodelets, key=lambda each: each.name):
        for port in by_name(nodelet.ports):
            if port.topic:
                ends = sources if port.direction == OUT else targets
                ends.setdefault(port.topic, []).append(PortRef(nodelet.name, port.name))
                if port.datatype not in ("", "*"):
                    types.setdefault(port.topic, port.datatype)
    return [
        Topic(
            name,
            types.get(name, ""),
            tuple(sources.get(name, ())),
            tuple(targets.get(name, ())),
        )
        for name in sorted({*sources, *targets})
    ]


def list_topics(snapshot: Model, topics: Sequence[Topic]) -> Iterator[str]:
    """Write the graph as lines: each topic with its ports, then the disconnected ports."""
    for topic in topics:
        yield f"{topic.name} [{topic.datatype or 'unknown type'}]"
        for source in topic.sources:
            yield f"    from {source}"
        for target in topic.targets:
            yield f"    to   {target}"
    loose = [
        f"    {port.direction:<4} {PortRef(nodelet.name, port.name)}"
        for nodelet in snapshot.nodelets
        for port in by_name(nodelet.ports)
        if not port.topic
    ]
    loose.extend(
        f"    {nodelet.name} ({_why_without_ports(nodelet)})"
        for nodelet in snapshot.nodelets
        if not nodelet.ports
    )
    if loose:
        yield "(disconnected)"
        yield from loose


def _why_without_ports(nodelet: NodeletStatus) -> str:
    state = state_of(nodelet)
    return "no ports" if state == "running" else state
