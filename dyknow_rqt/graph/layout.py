# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Layouts of a figure by graphviz: each part goes there as DOT, and comes back as JSON."""

from __future__ import annotations

import contextlib
import json
import re
from dataclasses import dataclass, field, replace
from typing import Any, Mapping, Sequence

from dyknow.graphviz import quote
from dyknow_rqt.graph.figure import Edge, Figure, Group, Vertex, VertexKind
from dyknow_rqt.graph.geometry import Drawing, Layout, Point, Size
from dyknow_rqt.graph.parts import MOST, Page, Piece, finished, spread


def without_crossings(figure: Figure, layout: Layout) -> list[Vertex]:
    """Sort the ports, from top to bottom, by their arrows.

    Ports without an arrow keep their places; the rest change places among themselves.
    """
    heights: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for edge in figure.edges:
        curve = layout.curves[edge]
        if edge.tail_port:
            height = curve[0].y, layout.centres[edge.head].y
            heights.setdefault((edge.tail, edge.tail_port), []).append(height)
        if edge.head_port:
            height = curve[-1].y, layout.centres[edge.tail].y
            heights.setdefault((edge.head, edge.head_port), []).append(height)

    def ordered(key: str, ports: Sequence[str]) -> tuple[str, ...]:
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


def _mean(heights: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Where the arrows of a port end at its nodelet and, if that is the same, where they lead."""
    at_nodelet, beyond = zip(*heights)
    return round(sum(at_nodelet) / len(heights)), sum(beyond) / len(heights)


#: Points of graphviz in an inch; a point is taken for a pixel.
_DPI = 72.0


class BadLayout(ValueError):
    """The answer of graphviz is not a layout of the figure."""


def to_dot(
    figure: Figure, sizes: Mapping[str, Size], gap: float = 52.0, around: Group = ()
) -> str:
    """Write a figure as DOT.

    ``gap`` has the pixels between ranks, for the words on an arrow. The box ``around`` all of it
    is left out.
    """
    lines = [
        "digraph dyknow {",
        f'  graph [rankdir="{"TB" if figure.is_downwards else "LR"}", '
        f'ranksep="{gap / _DPI:.2f}", nodesep="0.3", compound="true"];',
        '  node [fixedsize="true", fontname="sans-serif", fontsize="10"];',
        '  edge [fontname="sans-serif", fontsize="8"];',
    ]
    if len(figure.vertices) > MOST:
        lines.append('  graph [nslimit="2", nslimit1="2", mclimit="0.3", splines="line"];')
    lines += _members(figure, sizes, around, "  ")
    tail, head = ("s", "n") if figure.is_downwards else ("e", "w")
    for number, edge in enumerate(figure.edges):
        label = " → ".join(filter(None, (edge.tail_port, edge.head_port)))
        lines.append(
            f"  {quote(edge.tail)} -> {quote(edge.head)} "
            f'[id="e{number}", tailport="{tail}", headport="{head}", tooltip={quote(label)}'
            + (f", label={quote(edge.topic)}" if not _touches_topic(edge) else "")
            + "];"
        )
    lines.append("}")
    return "\n".join(lines) + "\n"


def read_graphs(answer: str) -> dict[str, Any]:
    """Read what ``dot -Tjson0`` answers for several graphs, by name; a rest is left out."""
    decoder, found, place = json.JSONDecoder(), {}, answer.find("{")
    with contextlib.suppress(ValueError, KeyError):
        while place >= 0:
            graph, end = decoder.raw_decode(answer, place)
            found[graph["name"]] = graph
            place = answer.find("{", end)
    return found


def read_layout(graph: Any, figure: Figure) -> Layout:
    """Read a graph of ``dot -Tjson0`` as a layout of a figure; else raise BadLayout."""
    try:
        height = float(graph["bb"].split(",")[3])
        objects: list[dict[str, Any]] = graph.get("objects", [])
        centres = {each["name"]: _point(each["pos"], height) for each in objects if "pos" in each}
        edges: list[dict[str, Any]] = graph.get("edges", [])
        curves = {figure.edges[int(each["id"][1:])]: _curve(each["pos"], height) for each in edges}
        wanted = {vertex.key for vertex in figure.vertices}
        if not wanted <= set(centres) or len(curves) != len(figure.edges):
            raise BadLayout("graphviz left out a part of the graph")
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        raise error if isinstance(error, BadLayout) else BadLayout(str(error)) from error
    return Layout(centres, curves)


def _members(
    figure: Figure, sizes: Mapping[str, Size], group: tuple[str, ...], indent: str
) -> list[str]:
    lines = [indent + _vertex(v, sizes[v.key]) for v in figure.vertices if v.group == group]
    for inner in figure.groups():
        if inner[:-1] == group:
            lines.append(f"{indent}subgraph {quote('cluster_' + ' '.join(inner))} {{")
            lines.append(f'{indent}  label={quote(inner[-1])}; labeljust="l";')
            lines += _members(figure, sizes, inner, indent + "  ")
            lines.append(indent + "}")
    return lines


def _vertex(vertex: Vertex, size: Size) -> str:
    return (
        f"{quote(vertex.key)} [label={quote(vertex.label)}, tooltip={quote(vertex.name)}, "
        f"shape={'box' if vertex.kind.is_square else 'ellipse'}, "
        f'width="{size.width / _DPI:.3f}", height="{size.height / _DPI:.3f}"];'
    )


def _touches_topic(edge: Edge) -> bool:
    return any(key.startswith(VertexKind.TOPIC.value + "_") for key in (edge.tail, edge.head))


def _point(text: str, height: float) -> Point:
    x, y = text.split(",")
    return Point(float(x), height - float(y))


def _curve(text: str, height: float) -> tuple[Point, ...]:
    """Read a spline: ``e,`` or ``s,`` marks where the tip of an arrow is, which ends the curve."""
    text = text.split(";")[0]
    tip = re.match(r"e,([-\d.e+]+,[-\d.e+]+) ", text)
    points = [_point(part, height) for part in text.split() if not part.startswith(("e,", "s,"))]
    if tip is not None:
        points[-1] = _point(tip.group(1), height)
    if len(points) < 4 or len(points) % 3 != 1:
        raise BadLayout(f"'{text}' is not a spline")
    return tuple(points)


@dataclass(frozen=True)
class DrawingOrder:
    """A figure that is to be drawn in a view of a shape, width by height.

    ``gap`` has the pixels between ranks, for the words on an arrow; ``anew`` ignores the last
    drawing, but not the places where the user has put vertices. Orders that differ in shape alone
    are equal: the drawing fits both.
    """

    figure: Figure = field(default_factory=Figure)
    sizes: Mapping[str, Size] = field(default_factory=dict)
    gap: float = 52.0
    shape: float = field(default=1.5, compare=False)
    anew: bool = False
    places: Mapping[str, Point] = field(default_factory=dict)


def arranged(
    order: DrawingOrder,
    parts: Sequence[Piece],
    layouts: Mapping[Piece, Layout],
    before: Drawing | None = None,
) -> Drawing:
    """Arrange the parts of a figure: those that graphviz has not laid out are spread.

    All but graphviz works from left to right, and a downward flow is turned for that. ``before``
    is the drawing on the screen; None to make one without regard to it.
    """
    figure, sizes, shape, places = order.figure, order.sizes, order.shape, order.places
    is_turned = figure.is_downwards
    widths = _turned_sizes(sizes) if is_turned else sizes

    def layout_of(part: Piece) -> Layout:
        found = layouts.get(part)
        if found is None:
            return spread(part, widths, shape, is_turned)
        return found.turned() if is_turned else found

    old = before
    if before is not None and before.figure.is_downwards != is_turned:
        old = None
    elif before is not None and is_turned:
        turned = before.layout.turned()
        old = replace(before, layout=turned, sizes=_turned_sizes(before.sizes))
    layout = Page(layout_of, widths, shape, is_turned).arrange(parts, old) if parts else Layout()
    if is_turned:
        places = {key: place.turned for key, place in places.items()}
    layout = finished(figure, layout.put_at(places), widths)
    vertices = tuple(without_crossings(figure, layout))
    if is_turned:
        layout = finished(figure, layout.turned(), sizes)
    return Drawing(replace(figure, vertices=vertices), sizes, layout, before is None)


def _turned_sizes(sizes: Mapping[str, Size]) -> dict[str, Size]:
    return {key: Size(*size[::-1]) for key, size in sizes.items()}
