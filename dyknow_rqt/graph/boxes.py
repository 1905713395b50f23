# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Boxes around vertices: of namespaces, nodelet managers or hosts, open or collapsed."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import AbstractSet, Dict, Iterable, Iterator, Mapping, Optional, Set

from dyknow.model.graph import NodeletStatus
from dyknow_rqt.graph.figure import (
    Boxes,
    Edge,
    Figure,
    Group,
    Options,
    Vertex,
    VertexKind,
    key_of,
    unboxed_figure_of,
)
from dyknow_rqt.graph.filters import with_namespaces
from dyknow_rqt.graph.snapshot import Snapshot


def figure_of(snapshot: Snapshot, options: Options) -> Figure:
    """Make the figure of a snapshot."""
    figure = unboxed_figure_of(snapshot, options)
    if options.boxes is Boxes.NAMESPACES:
        figure = _boxed(figure, options.depth)
    else:
        homes = {
            each.name: _home(each, options.boxes)[: options.depth] for each in snapshot.nodelets
        }
        figure = _boxed_by_home(figure, homes)
    return _collapsed(figure, options.collapsed)


def _boxed(figure: Figure, depth: int) -> Figure:
    """Assign vertices to the boxes of their namespaces; topics alone make no box."""
    spaces = {v.key: tuple(with_namespaces(v.name)[:-1][:depth]) for v in figure.vertices}
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


def _home(nodelet: NodeletStatus, boxes: Boxes) -> Group:
    """The box of a nodelet's host, in it that of its nodelet manager; or that alone."""
    parts = (nodelet.host, nodelet.manager) if boxes is Boxes.HOSTS else (nodelet.manager,)
    return tuple(part for part in parts if part)


def _boxed_by_home(figure: Figure, homes: Mapping[str, Group]) -> Figure:
    """Assign nodelets to their boxes, and topics to the innermost that holds all of their ends.

    Args:
        figure: what to assign.
        homes: of nodelets.
    """
    groups = {
        vertex.key: homes.get(vertex.name, ())
        for vertex in figure.vertices
        if vertex.kind is VertexKind.NODELET
    }
    neighbours = figure.neighbours()
    for vertex in figure.vertices:
        ends = [groups.get(key, ()) for key in neighbours[vertex.key]]
        if vertex.kind is VertexKind.TOPIC:
            groups[vertex.key] = tuple(os.path.commonprefix(ends))
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
        Vertex(_key(group), VertexKind.BOX, group[-1], group[:-1], note=f"{count} nodelets")
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
    return key_of(VertexKind.BOX, " ".join(group))
