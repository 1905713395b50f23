# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Writes a figure as DOT, and reads the layout that graphviz makes of it.

The text depends on nothing but the figure and the sizes, and is sorted: equal figures are laid out
equally.
"""

from __future__ import annotations

import json
import re
from typing import Any, Dict, List, Mapping, Tuple

from dyknow.graphviz import quote
from dyknow_rqt.graph.figure import Edge, Figure, Vertex, VertexKind
from dyknow_rqt.graph.geometry import Layout, Point, Rectangle, Size

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
    """Write a figure as DOT.

    Args:
        figure: what to write.
        sizes: of the vertices, as they are drawn.
        gap: room for the words on an arrow, in pixels.
    """
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
    """Read what ``dot -Tjson0`` answers for a figure.

    Raises:
        BadLayout: it is something else.
    """
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
