# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The computation graph by topics, and as text."""

from __future__ import annotations

from typing import TYPE_CHECKING, Iterator, Sequence

from dyknow.cli.views import state_of
from dyknow.model.graph import PortRef
from dyknow.wiring.ports import by_name
from dyknow.wiring.topics import Topic

if TYPE_CHECKING:
    from dyknow.model.graph import Model, NodeletStatus


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
