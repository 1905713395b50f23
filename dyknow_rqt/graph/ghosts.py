# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A plan in the figure: the parts that it would bring, keep and drop."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, Iterable, List, Mapping, Sequence, Set

from dyknow.model.graph import PortRef
from dyknow_rqt.graph.figure import Edge, Figure, Vertex, VertexKind, key_of
from dyknow_rqt.graph.snapshot import Snapshot
from dyknow_rqt.graph.ways import WayPart


def fates_of(parts: Iterable[WayPart]) -> Mapping[str, bool]:
    """Keys of the nodelets that a plan uses on (True), or drops."""
    named = (part for part in parts if part.nodelet)
    return {
        key_of(VertexKind.NODELET, part.nodelet): not part.how.startswith("dropped")
        for part in named
    }


def with_ghosts(figure: Figure, snapshot: Snapshot, parts: Sequence[WayPart]) -> Figure:
    """Add the nodelets that a plan would bring, with arrows from their sources."""
    drawn = {vertex.key for vertex in figure.vertices}
    ghosts: Dict[str, Vertex] = {}
    edges: Set[Edge] = set()
    above: List[str] = []
    for part in parts:
        key = _key(part, snapshot, drawn)
        if part.is_new:
            note = "\n".join(filter(None, (part.bindings, f"cost {part.cost or 0}")))
            ghosts[key] = Vertex(key, VertexKind.GHOST, part.label, note=note)
        del above[part.depth :]
        if part.port and {key, above[-1]} <= drawn | set(ghosts):
            edges.add(Edge(key, "", above[-1], "", part.port))
        above.append(key)
    vertices = sorted([*figure.vertices, *ghosts.values()], key=lambda vertex: vertex.key)
    return replace(figure, vertices=tuple(vertices), edges=tuple(sorted({*figure.edges, *edges})))


def _key(part: WayPart, snapshot: Snapshot, drawn: Set[str]) -> str:
    """The vertex of a part: of one that runs its topic, if it is drawn."""
    topic = part.what
    if part.nodelet:
        port = snapshot.port(PortRef(part.nodelet, part.what.rpartition(".")[2]))
        topic = port.topic if port is not None else ""
    elif part.label:
        return key_of(VertexKind.GHOST, f"{part.label} {part.bindings}".strip())
    key = key_of(VertexKind.TOPIC, topic)
    return key if key in drawn else key_of(VertexKind.NODELET, part.nodelet)
