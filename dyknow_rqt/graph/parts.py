# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Divides a figure into parts that graphviz lays out one by one, and packs them like a page.

A part is a set of vertices that arrows and boxes connect. One that is large is divided into its
boxes, and these into the boxes in them. A change of one part thus moves no other, and boxes are
around their nodelets by construction.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Callable, Iterator, Mapping, Sequence

from dyknow_rqt.graph.figure import Edge, Figure, Group, Vertex, VertexKind
from dyknow_rqt.graph.geometry import (
    Drawing,
    Layout,
    Point,
    Rectangle,
    Size,
    around,
    boxes_around,
    curve_between,
)
from dyknow_rqt.graph.stabilise import stabilise

#: Vertices of a part that is not divided.
MOST = 150
#: Pixels between two parts.
_GAP = 30.0
#: Widths that are tried for a page.
_TRIES = 40


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of a figure, inside of boxes of a depth, with the arrows between its vertices.

    It has parts if it is one box, else graphviz lays it out as a whole.
    """

    figure: Figure
    depth: int
    parts: tuple[Piece, ...] = ()

    @property
    def box(self) -> Group:
        """The box around all of it."""
        return self.figure.vertices[0].group[: self.depth]

    def leaves(self) -> Iterator[Piece]:
        """Parts that graphviz lays out."""
        if not self.parts:
            yield self
        for part in self.parts:
            yield from part.leaves()


def divide(
    figure: Figure, most: int = MOST, depth: int = 0, fineness: int = 0
) -> tuple[Piece, ...]:
    """Divide the inside of boxes of a depth, in reading order, into parts of ``most`` vertices.

    Fineness 0: arrows hold a part together; 1: those outside of boxes, and those of topics
    outside; 2: only the former, and none where each vertex is a part.
    """
    found: list[Piece] = []
    for piece in _components(figure, depth, fineness if most > 1 else 3):
        if len(piece.vertices) <= most:
            found.append(Piece(piece, depth))
        elif fineness < 2 and most > 1:
            found += divide(piece, most, depth, fineness + 1)
        elif len(piece.vertices[0].group) > depth:
            found.append(Piece(piece, depth, divide(piece, most, depth + 1)))
        else:
            found.append(Piece(piece, depth))
    return tuple(found)


def _components(figure: Figure, depth: int, fineness: int) -> list[Figure]:
    """Divide a figure into its connected components, in reading order."""
    leaders: dict[str, str] = {vertex.key: vertex.key for vertex in figure.vertices}

    def leader(key: str) -> str:
        while leaders[key] != key:
            leaders[key] = leaders[leaders[key]]
            key = leaders[key]
        return key

    boxes: dict[str, str] = {}
    inside = set()
    for vertex in figure.vertices:
        if len(vertex.group) > depth:
            inside.add(vertex.key)
            first = boxes.setdefault(vertex.group[depth], vertex.key)
            leaders[leader(vertex.key)] = leader(first)
    topic, held = VertexKind.TOPIC.value + "_", set()
    for edge in figure.edges if fineness < 3 else ():
        ends = [key for key in (edge.tail, edge.head) if key not in inside]
        is_held = fineness == 0 or len(ends) == 2
        if fineness == 1 and len(ends) == 1 and ends[0].startswith(topic):
            is_held = ends[0] not in held  # a topic stands beside one of its nodelets
            held.add(ends[0])
        if is_held:
            leaders[leader(edge.tail)] = leader(edge.head)
    found: dict[str, tuple[list[Vertex], list[Edge]]] = {}
    for vertex in figure.vertices:
        found.setdefault(leader(vertex.key), ([], []))[0].append(vertex)
    for edge in figure.edges:
        if leader(edge.tail) == leader(edge.head):
            found[leader(edge.tail)][1].append(edge)
    figures = [
        replace(figure, vertices=tuple(vertices), edges=tuple(edges))
        for vertices, edges in found.values()
    ]
    return sorted(figures, key=lambda each: min(_reading(v, depth) for v in each.vertices))


def _reading(vertex: Vertex, depth: int) -> list[object]:
    """Sorts by boxes and names, numbers by their values."""
    text = " ".join((*vertex.group[depth:], vertex.name))
    return [int(each) if each.isdecimal() else each for each in re.split(r"(\d+)", text)]


class Page:
    """Arranges parts on a page of a shape: width by height."""

    def __init__(
        self,
        layouts: Callable[[Piece], Layout],
        sizes: Mapping[str, Size],
        shape: float,
        is_turned: bool,
    ) -> None:
        """``layouts`` has those of graphviz; ``is_turned`` says that x and y will be swapped."""
        self._layouts = layouts
        self._sizes = sizes
        self._shape = shape
        self._is_turned = is_turned

    def arrange(self, parts: Sequence[Piece], before: Drawing | None = None) -> Layout:
        """Arrange all parts of a figure.

        Those that are as they were ``before`` keep their places. Those that changed do so too if
        there is room; the rest comes below or beside all of these.
        """
        known = before.layout.centres if before is not None else {}
        vertices = [vertex.key for part in parts for vertex in part.figure.vertices]
        if before is None or 2 * sum(key in known for key in vertices) < len(vertices):
            return self._packed(parts, [self._laid_out(part) for part in parts])
        old_edges: dict[str, list[Edge]] = {}
        for edge in before.figure.edges:
            old_edges.setdefault(edge.tail, []).append(edge)
        placed = {part: self._as_before(part, before, old_edges) for part in parts}
        taken = [area for part, old in placed.items() if old for area in self._outlines(part, old)]
        rest = []
        for part in [part for part, old in placed.items() if old is None]:
            layout = self._laid_out(part)
            if any(vertex.key in known for vertex in part.figure.vertices):
                layout = stabilise(
                    before.layout, before.figure, layout, part.figure, self._sizes, taken
                )
                areas = self._outlines(part, layout)
                if not any(area.meets(other) for area in areas for other in taken):
                    placed[part] = layout
                    taken += areas
                    continue
            rest.append((part, layout))
        layouts = [layout for layout in placed.values() if layout is not None]
        if rest:
            layouts.append(self._beside(taken, self._packed(*zip(*rest)), [p for p, _ in rest]))
        return _joined(layouts)

    def _outlines(self, part: Piece, layout: Layout) -> list[Rectangle]:
        """The areas of the outermost boxes of a part, and of the vertices beside these."""
        centres = {v.key: layout.centres[v.key] for v in part.figure.vertices}
        groups = {v.key: v.group[part.depth :] for v in part.figure.vertices}
        boxes = boxes_around(groups, centres, self._sizes, self._is_turned)
        return [box for group, box in boxes.items() if len(group) == 1] + [
            around(centre, self._sizes[key]) for key, centre in centres.items() if not groups[key]
        ]

    def _laid_out(self, part: Piece) -> Layout:
        if not part.parts:
            return self._layouts(part)
        return self._packed(part.parts, [self._laid_out(each) for each in part.parts])

    def _packed(self, parts: Sequence[Piece], layouts: Sequence[Layout]) -> Layout:
        areas = [
            _area([*self._outlines(part, layout), *_spots(layout)])
            for part, layout in zip(parts, layouts)
        ]
        sizes = [Size(a.right - a.left, a.bottom - a.top) for a in areas]
        if self._is_turned:
            sizes = [Size(size.height, size.width) for size in sizes]
        moved = []
        for layout, area, (x, y) in zip(layouts, areas, pack(sizes, self._shape)):
            x, y = (y, x) if self._is_turned else (x, y)
            moved.append(layout.moved(Point(x - area.left, y - area.top)))
        return _joined(moved)

    def _beside(self, taken: list[Rectangle], layout: Layout, parts: Sequence[Piece]) -> Layout:
        """Move a layout below or to the right of the others, where the page stays larger."""
        own = _area([a for part in parts for a in self._outlines(part, layout)])
        area = _area(taken)
        below = layout.moved(Point(area.left - own.left, area.bottom + _GAP - own.top))
        right = layout.moved(Point(area.right + _GAP - own.left, area.top - own.top))

        def scale(moved: Layout) -> float:
            whole = _area([area, *_spots(moved)])
            width, height = whole.right - whole.left, whole.bottom - whole.top
            if self._is_turned:
                width, height = height, width
            return min(self._shape / max(width, 1.0), 1.0 / max(height, 1.0))

        return max((below, right), key=scale)

    def _as_before(
        self, part: Piece, before: Drawing, old_edges: Mapping[str, Sequence[Edge]]
    ) -> Layout | None:
        """The layout of a part that has not changed; None if it has."""
        centres, curves = before.layout.centres, before.layout.curves
        keys = {vertex.key for vertex in part.figure.vertices}
        edges = sum(edge.head in keys for key in keys for edge in old_edges.get(key, ()))
        if edges != len(part.figure.edges) or not all(e in curves for e in part.figure.edges):
            return None
        if any(k not in centres or before.sizes[k] != self._sizes[k] for k in keys):
            return None
        return Layout({k: centres[k] for k in keys}, {e: curves[e] for e in part.figure.edges})


def pack(sizes: Sequence[Size], shape: float) -> list[Point]:
    """Set rectangles in lines from left to right, so that the page of that shape is largest."""
    widest = max(size.width for size in sizes) + _GAP
    total = sum(size.width + _GAP for size in sizes)
    best, largest = [Point(0.0, 0.0)] * len(sizes), 0.0
    for number in range(_TRIES):
        limit = widest * (total / widest) ** (number / (_TRIES - 1)) + 0.5
        places, x, y, line, width = [], 0.0, 0.0, 0.0, 0.0
        for size in sizes:
            if x + size.width + _GAP > limit and x:
                x, y, line = 0.0, y + line, 0.0
            places.append(Point(x, y))
            x, line = x + size.width + _GAP, max(line, size.height + _GAP)
            width = max(width, x)
        scale = min(shape / width, 1.0 / (y + line))
        if scale > largest:
            best, largest = places, scale
    return best


def spread(part: Piece, sizes: Mapping[str, Size], shape: float, is_turned: bool) -> Layout:
    """Lay out a part without graphviz: its vertices are set like words."""

    def alone(leaf: Piece) -> Layout:
        return Layout({vertex.key: Point(0.0, 0.0) for vertex in leaf.figure.vertices})

    parts = divide(part.figure, 1, part.depth)
    return Page(alone, sizes, shape, is_turned).arrange(parts)


def finished(figure: Figure, layout: Layout, sizes: Mapping[str, Size]) -> Layout:
    """Add the arrows that lead from part to part, and the boxes."""
    centres, curves = layout.centres, dict(layout.curves)
    for edge in figure.edges:
        if edge not in curves:
            curves[edge] = curve_between(
                centres[edge.tail], sizes[edge.tail], centres[edge.head], sizes[edge.head]
            )
    groups = {vertex.key: vertex.group for vertex in figure.vertices}
    return Layout(centres, curves, boxes_around(groups, centres, sizes))


def _joined(layouts: Sequence[Layout]) -> Layout:
    centres: dict[str, Point] = {}
    curves: dict[Edge, tuple[Point, ...]] = {}
    for layout in layouts:
        centres.update(layout.centres)
        curves.update(layout.curves)
    return Layout(centres, curves)


def _spots(layout: Layout) -> Iterator[Rectangle]:
    """The places that arrows pass."""
    for curve in layout.curves.values():
        for x, y in curve:
            yield Rectangle(x, y, x, y)


def _area(areas: Sequence[Rectangle]) -> Rectangle:
    lefts, tops, rights, bottoms = zip(*areas)
    return Rectangle(min(lefts), min(tops), max(rights), max(bottoms))
