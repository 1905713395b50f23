# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Layouts of a figure: by graphviz, or by a simpler layering when graphviz takes too long.

The graph goes to graphviz as DOT, and comes back as JSON.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, Tuple

from dyknow.graphviz import quote
from dyknow_rqt.graph.figure import Edge, Figure, Vertex, VertexKind
from dyknow_rqt.graph.geometry import (
    Drawing,
    Layout,
    Point,
    Rectangle,
    Size,
    boxes_around,
    curve_between,
)
from dyknow_rqt.graph.stabilise import stabilise


def without_crossings(figure: Figure, layout: Layout) -> List[Vertex]:
    """Sort the ports, from top to bottom, by their arrows.

    Ports without an arrow keep their places; the rest change places among themselves.
    """
    heights: Dict[Tuple[str, str], List[Tuple[float, float]]] = {}
    for edge in figure.edges:
        curve = layout.curves[edge]
        if edge.tail_port:
            height = curve[0].y, layout.centres[edge.head].y
            heights.setdefault((edge.tail, edge.tail_port), []).append(height)
        if edge.head_port:
            height = curve[-1].y, layout.centres[edge.tail].y
            heights.setdefault((edge.head, edge.head_port), []).append(height)

    def ordered(key: str, ports: Sequence[str]) -> Tuple[str, ...]:
        places = [place for place, port in enumerate(ports) if (key, port) in heights]
        by_height = sorted(
            (ports[place] for place in places), key=lambda port: _mean(heights[key, port])
        )
        found = list(ports)
        for place, port in zip(places, by_height):
            found[place] = port
        return tuple(found)

    return [
        replace(v, inputs=ordered(v.key, v.inputs), outputs=ordered(v.key, v.outputs))
        for v in figure.vertices
    ]


def _mean(heights: Sequence[Tuple[float, float]]) -> Tuple[float, float]:
    """Where the arrows of a port end at its nodelet and, if that is the same, where they lead."""
    at_nodelet, beyond = zip(*heights)
    return round(sum(at_nodelet) / len(heights)), sum(beyond) / len(heights)


_COLUMN_GAP = 60.0
_ROW_GAP = 22.0
_SWEEPS = 4


def layered(figure: Figure, sizes: Mapping[str, Size]) -> Layout:
    """Place each vertex to the right of its sources and near its neighbours."""
    layers = _layers(figure)
    columns: Dict[int, List[str]] = {}
    for vertex in sorted(figure.vertices, key=lambda v: (v.group, v.name, v.key)):
        columns.setdefault(layers[vertex.key], []).append(vertex.key)
    _untangle(columns, figure)
    centres: Dict[str, Point] = {}
    x = 0.0
    for layer in sorted(columns):
        keys = columns[layer]
        width = max(sizes[key].width for key in keys)
        y = -sum(sizes[key].height + _ROW_GAP for key in keys) / 2
        for key in keys:
            centres[key] = Point(x + width / 2, y + sizes[key].height / 2)
            y += sizes[key].height + _ROW_GAP
        x += width + _COLUMN_GAP
    curves = {
        e: curve_between(centres[e.tail], sizes[e.tail], centres[e.head], sizes[e.head])
        for e in figure.edges
    }
    groups = {vertex.key: vertex.group for vertex in figure.vertices}
    return Layout(centres, curves, boxes_around(groups, centres, sizes))


def _layers(figure: Figure) -> Dict[str, int]:
    """The length of the longest path to each vertex; edges that close a cycle are ignored."""
    followers: Dict[str, List[str]] = {vertex.key: [] for vertex in figure.vertices}
    for edge in figure.edges:
        followers[edge.tail].append(edge.head)
    order: List[str] = []
    done: Set[str] = set()
    back: Set[Tuple[str, str]] = set()
    for start in followers:
        if start in done:
            continue
        path = [(start, iter(followers[start]))]
        on_path = {start}
        while path:
            key, rest = path[-1]
            head = next(rest, None)
            if head is None:
                path.pop()
                on_path.discard(key)
                done.add(key)
                order.append(key)
            elif head in on_path:
                back.add((key, head))
            elif head not in done:
                path.append((head, iter(followers[head])))
                on_path.add(head)
    layers = dict.fromkeys(followers, 0)
    for key in reversed(order):
        for head in followers[key]:
            if (key, head) not in back:
                layers[head] = max(layers[head], layers[key] + 1)
    return layers


def _untangle(columns: Mapping[int, List[str]], figure: Figure) -> None:
    """Sort each column by the places of its neighbours in the other columns."""
    neighbours = {key: sorted(keys) for key, keys in figure.neighbours().items()}
    for sweep in range(_SWEEPS):
        rows = {key: row / len(keys) for keys in columns.values() for row, key in enumerate(keys)}
        for layer in sorted(columns, reverse=bool(sweep % 2)):
            weights = {
                key: sum(rows[n] for n in neighbours[key]) / len(neighbours[key])
                if neighbours[key]
                else rows[key]
                for key in columns[layer]
            }
            columns[layer].sort(key=lambda key: (weights[key], key))
            for row, key in enumerate(columns[layer]):
                rows[key] = row / len(columns[layer])


#: Points of graphviz in an inch; a point is taken for a pixel.
_DPI = 72.0
#: With more vertices graphviz optimises less.
_MANY = 150
_SHAPES = {
    VertexKind.NODELET: "ellipse",
    VertexKind.TOPIC: "box",
    VertexKind.NODE: "ellipse",
    VertexKind.BOX: "box",
}


class BadLayout(ValueError):
    """The answer of graphviz is not a layout of the figure."""


def to_dot(figure: Figure, sizes: Mapping[str, Size], gap: float = 52.0) -> str:
    """Write a figure as DOT, with a gap between ranks (pixels) for the words on an arrow."""
    lines = [
        "digraph dyknow {",
        f'  graph [rankdir="{"TB" if figure.is_downwards else "LR"}", '
        f'ranksep="{gap / _DPI:.2f}", nodesep="0.3", compound="true"];',
        '  node [fixedsize="true", fontname="sans-serif", fontsize="10"];',
        '  edge [fontname="sans-serif", fontsize="8"];',
    ]
    if len(figure.vertices) > _MANY:
        lines.append('  graph [nslimit="2", nslimit1="2", mclimit="0.3", splines="line"];')
    lines += _members(figure, sizes, (), "  ")
    tail, head = ("s", "n") if figure.is_downwards else ("e", "w")
    for number, edge in enumerate(figure.edges):
        label = _ports(edge)
        lines.append(
            f"  {quote(edge.tail)} -> {quote(edge.head)} "
            f'[id="e{number}", tailport="{tail}", headport="{head}", tooltip={quote(label)}'
            + (f", label={quote(edge.topic)}" if not _touches_topic(edge) else "")
            + "];"
        )
    lines.append("}")
    return "\n".join(lines) + "\n"


def read_layout(answer: str, figure: Figure) -> Layout:
    """Read what ``dot -Tjson0`` answers for a figure; anything else is a BadLayout."""
    try:
        graph = json.loads(answer)
        height = float(graph["bb"].split(",")[3])
        objects: List[Dict[str, Any]] = graph.get("objects", [])
        centres = {each["name"]: _point(each["pos"], height) for each in objects if "pos" in each}
        edges: List[Dict[str, Any]] = graph.get("edges", [])
        curves = {figure.edges[int(each["id"][1:])]: _curve(each["pos"], height) for each in edges}
        names = {_cluster(group): group for group in figure.groups()}
        boxes = {
            names[each["name"]]: _rectangle(each["bb"], height)
            for each in objects
            if each["name"] in names and "bb" in each
        }
        wanted = {vertex.key for vertex in figure.vertices}
        if not wanted <= set(centres) or len(curves) != len(figure.edges):
            raise BadLayout("graphviz left out a part of the graph")
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise error if isinstance(error, BadLayout) else BadLayout(str(error)) from error
    return Layout(centres, curves, boxes)


def _members(
    figure: Figure, sizes: Mapping[str, Size], group: Tuple[str, ...], indent: str
) -> List[str]:
    lines = [indent + _vertex(v, sizes[v.key]) for v in figure.vertices if v.group == group]
    for inner in figure.groups():
        if inner[:-1] == group:
            lines.append(f"{indent}subgraph {quote(_cluster(inner))} {{")
            lines.append(f'{indent}  label={quote(inner[-1])}; labeljust="l";')
            lines += _members(figure, sizes, inner, indent + "  ")
            lines.append(indent + "}")
    return lines


def _vertex(vertex: Vertex, size: Size) -> str:
    return (
        f"{quote(vertex.key)} [label={quote(vertex.label)}, tooltip={quote(vertex.name)}, "
        f"shape={_SHAPES[vertex.kind]}, "
        f'width="{size.width / _DPI:.3f}", height="{size.height / _DPI:.3f}"];'
    )


def _cluster(group: Tuple[str, ...]) -> str:
    return "cluster_" + " ".join(group)


def _touches_topic(edge: Edge) -> bool:
    return any(key.startswith(VertexKind.TOPIC.value + "_") for key in (edge.tail, edge.head))


def _ports(edge: Edge) -> str:
    return " → ".join(part for part in (edge.tail_port, edge.head_port) if part)


def _point(text: str, height: float) -> Point:
    x, y = text.split(",")
    return Point(float(x), height - float(y))


def _rectangle(text: str, height: float) -> Rectangle:
    left, low, right, high = (float(part) for part in text.split(","))
    return Rectangle(left, height - high, right, height - low)


def _curve(text: str, height: float) -> Tuple[Point, ...]:
    """Read a spline: ``e,`` or ``s,`` marks where the tip of an arrow is, which ends the curve."""
    text = text.split(";")[0]
    tip = re.match(r"e,([-\d.e+]+,[-\d.e+]+) ", text)
    points = [_point(part, height) for part in text.split() if not part.startswith(("e,", "s,"))]
    if tip is not None:
        points[-1] = _point(tip.group(1), height)
    if len(points) < 4 or len(points) % 3 != 1:
        raise BadLayout(f"'{text}' is not a spline")
    return tuple(points)


def arranged(
    figure: Figure, sizes: Mapping[str, Size], answer: bytes, before: Optional[Drawing] = None
) -> Tuple[Drawing, str]:
    """Place the parts of a figure.

    All but graphviz works from left to right, and a downward flow is turned for that.

    Args:
        figure: what to draw.
        sizes: of its vertices.
        answer: the output of graphviz.
        before: the drawing on the screen; None to make a drawing without regard to it.

    Returns:
        The drawing, and why a simpler layout had to be used; empty if that was not so.
    """
    is_turned, complaint = figure.is_downwards, ""
    widths = {key: Size(*size[::-1]) for key, size in sizes.items()} if is_turned else sizes
    try:
        layout = _turned(read_layout(answer.decode("utf-8", "replace"), figure), is_turned)
    except BadLayout as error:
        layout, complaint = layered(figure, widths), f"graphviz: {error}"
    if before is not None and before.figure.is_downwards == is_turned:
        old = _turned(before.layout, is_turned)
        layout = stabilise(old, before.figure, layout, figure, widths)
    vertices = tuple(without_crossings(figure, layout))
    if is_turned:
        layout = _turned(layout, is_turned)
        groups = {vertex.key: vertex.group for vertex in vertices}
        layout = replace(layout, boxes=boxes_around(groups, layout.centres, sizes))
    drawing = Drawing(replace(figure, vertices=vertices), sizes, layout, before is None)
    return drawing, complaint


def _turned(layout: Layout, is_turned: bool) -> Layout:
    return layout.turned() if is_turned else layout
