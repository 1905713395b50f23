# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Boxes around vertices: of namespaces or of nodelet managers, open or collapsed."""

from __future__ import annotations

from dataclasses import replace
from typing import AbstractSet, Dict, Iterable, Iterator, Mapping, Optional, Set

from dyknow_rqt.graph.figure import (
    Edge,
    Figure,
    Group,
    Options,
    Vertex,
    VertexKind,
    key_of,
    unboxed_figure_of,
)
from dyknow_rqt.graph.snapshot import Snapshot


def figure_of(snapshot: Snapshot, options: Options) -> Figure:
    """Make the figure of a snapshot."""
    figure = unboxed_figure_of(snapshot, options)
    if options.depth and options.by_manager:
        figure = _boxed_by_manager(figure, {n.name: n.manager for n in snapshot.nodelets})
    else:
        figure = _boxed(figure, options.depth)
    return _collapsed(figure, options.collapsed)


def _boxed(figure: Figure, depth: int) -> Figure:
    """Assign vertices to the boxes of their namespaces; topics alone make no box."""
    spaces = {v.key: tuple(v.name.strip("/").split("/")[:-1])[:depth] for v in figure.vertices}
    homes: Set[Group] = set()
    for vertex in figure.vertices:
        if vertex.kind is not VertexKind.TOPIC:
            homes.update(spaces[vertex.key][:size] for size in range(depth + 1))

    def home(vertex: Vertex) -> Group:
        group = spaces[vertex.key]
        while group and group not in homes:
            group = group[:-1]
        return group

    return replace(figure, vertices=tuple(replace(v, group=home(v)) for v in figure.vertices))


def _boxed_by_manager(figure: Figure, managers: Mapping[str, str]) -> Figure:
    """Assign nodelets to the boxes of their managers, and topics that stay in one box to it.

    Args:
        figure: what to assign.
        managers: of nodelets; empty for those without.
    """
    groups: Dict[str, Group] = {
        v.key: (managers.get(v.name, "").strip("/"),)
        for v in figure.vertices
        if v.kind is VertexKind.NODELET and managers.get(v.name)
    }
    neighbours = figure.neighbours()
    for vertex in figure.vertices:
        ends = {groups.get(key, ()) for key in neighbours[vertex.key]}
        if vertex.kind is VertexKind.TOPIC and len(ends) == 1:
            groups[vertex.key] = ends.pop()
    vertices = (replace(v, group=groups.get(v.key, ())) for v in figure.vertices)
    return replace(figure, vertices=tuple(vertices))


def _collapsed(figure: Figure, groups: AbstractSet[Group]) -> Figure:
    """Draw some boxes as one vertex each, with the arrows of all that is in them."""
    if not groups:
        return figure
    homes = {v.key: _outermost(v.group, groups) for v in figure.vertices}
    counts: Dict[Group, int] = {}
    for vertex in figure.vertices:
        home = homes[vertex.key]
        if home is not None:
            counts[home] = counts.get(home, 0) + (vertex.kind is not VertexKind.TOPIC)
    boxes = [
        Vertex(_key(group), VertexKind.BOX, _name(group), group[:-1], note=f"{count} nodelets")
        for group, count in counts.items()
    ]
    others = [v for v in figure.vertices if homes[v.key] is None]
    edges: Dict[object, Edge] = {}
    for edge in _led(figure.edges, homes):
        is_between_boxes = edge.tail_port == edge.head_port == ""
        edges.setdefault(edge[:4] if is_between_boxes else edge, edge)
    return replace(
        figure,
        vertices=tuple(sorted([*others, *boxes], key=lambda v: v.key)),
        edges=tuple(sorted(edges.values())),
    )


def _led(edges: Iterable[Edge], homes: Mapping[str, Optional[Group]]) -> Iterator[Edge]:
    """Lead arrows to the boxes that hold their ends."""
    for edge in edges:
        tail, head = homes[edge.tail], homes[edge.head]
        if tail is not None:
            edge = edge._replace(tail=_key(tail), tail_port="")
        if head is not None:
            edge = edge._replace(head=_key(head), head_port="")
        if edge.tail != edge.head:
            yield edge


def _outermost(group: Group, groups: AbstractSet[Group]) -> Optional[Group]:
    prefixes = (group[:size] for size in range(1, len(group) + 1))
    return next((prefix for prefix in prefixes if prefix in groups), None)


def _key(group: Group) -> str:
    return key_of(VertexKind.BOX, _name(group))


def _name(group: Group) -> str:
    return "/" + "/".join(group)
