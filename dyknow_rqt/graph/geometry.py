# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Geometry of the drawing: x to the right, y downwards, in pixels."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict, Mapping, NamedTuple, Tuple

from dyknow_rqt.graph.figure import Edge, Figure


class Point(NamedTuple):
    """A place or a displacement."""

    x: float
    y: float

    def plus(self, other: Point) -> Point:
        """Move by a displacement."""
        return Point(self.x + other.x, self.y + other.y)

    def minus(self, other: Point) -> Point:
        """Displacement from the other place to this one."""
        return Point(self.x - other.x, self.y - other.y)

    def distance(self, other: Point) -> float:
        """The larger of the distances in x and in y."""
        return max(abs(self.x - other.x), abs(self.y - other.y))


class Size(NamedTuple):
    """Width and height of a vertex."""

    width: float
    height: float


class Rectangle(NamedTuple):
    """Left, top, right and bottom."""

    left: float
    top: float
    right: float
    bottom: float

    def grown(self, margin: float) -> Rectangle:
        """Add a margin all around."""
        left, top, right, bottom = self
        return Rectangle(left - margin, top - margin, right + margin, bottom + margin)

    def joined(self, other: Rectangle) -> Rectangle:
        """The smallest rectangle around both."""
        return Rectangle(
            min(self.left, other.left),
            min(self.top, other.top),
            max(self.right, other.right),
            max(self.bottom, other.bottom),
        )

    @property
    def sides(self) -> Tuple[Rectangle, ...]:
        """The lines around it."""
        left, top, right, bottom = self
        return (
            Rectangle(left - 1, top, left + 1, bottom),
            Rectangle(right - 1, top, right + 1, bottom),
            Rectangle(left, top - 1, right, top + 1),
            Rectangle(left, bottom - 1, right, bottom + 1),
        )

    def meets(self, other: Rectangle) -> bool:
        """Whether they overlap."""
        return (
            self.left < other.right
            and other.left < self.right
            and self.top < other.bottom
            and other.top < self.bottom
        )


def around(centre: Point, size: Size) -> Rectangle:
    """Rectangle of that size around a place."""
    x, y = centre
    return Rectangle(
        x - size.width / 2, y - size.height / 2, x + size.width / 2, y + size.height / 2
    )


@dataclass(frozen=True)
class Layout:
    """The places of the vertices, edges and boxes of a figure.

    Attributes:
        centres: of the vertices, by key.
        curves: control points of cubic Bézier curves, 3 n + 1 of them, from tail to head.
        boxes: of namespaces.
    """

    centres: Mapping[str, Point] = field(default_factory=dict)
    curves: Mapping[Edge, Tuple[Point, ...]] = field(default_factory=dict)
    boxes: Mapping[Tuple[str, ...], Rectangle] = field(default_factory=dict)

    def turned(self) -> Layout:
        """Swap x and y: from left to right becomes from top to bottom."""
        return Layout(
            {key: Point(y, x) for key, (x, y) in self.centres.items()},
            {edge: tuple(Point(y, x) for x, y in curve) for edge, curve in self.curves.items()},
            {
                group: Rectangle(r.top, r.left, r.bottom, r.right)
                for group, r in self.boxes.items()
            },
        )

    def moved(self, by: Point) -> Layout:
        """Move all of it."""
        return Layout(
            {key: place.plus(by) for key, place in self.centres.items()},
            {
                edge: tuple(place.plus(by) for place in curve)
                for edge, curve in self.curves.items()
            },
            {
                group: Rectangle(r.left + by.x, r.top + by.y, r.right + by.x, r.bottom + by.y)
                for group, r in self.boxes.items()
            },
        )


@dataclass(frozen=True)
class Drawing:
    """A figure with the sizes and the places of its parts.

    Attributes:
        figure: what is drawn; the ports of its vertices are in an order without crossings.
        sizes: of the vertices.
        layout: places of all parts.
        is_anew: made without regard to the drawing before.
    """

    figure: Figure = field(default_factory=Figure)
    sizes: Mapping[str, Size] = field(default_factory=dict)
    layout: Layout = field(default_factory=Layout)
    is_anew: bool = False


def curve_between(tail: Point, tail_size: Size, head: Point, head_size: Size) -> Tuple[Point, ...]:
    """Lead an arrow from the right end of one vertex to the left end of another."""
    start = Point(tail.x + tail_size.width / 2, tail.y)
    end = Point(head.x - head_size.width / 2, head.y)
    reach = max(40.0, abs(end.x - start.x) / 2)
    return start, Point(start.x + reach, start.y), Point(end.x - reach, end.y), end


def boxes_around(
    groups: Mapping[str, Tuple[str, ...]],
    centres: Mapping[str, Point],
    sizes: Mapping[str, Size],
    margin: float = 8.0,
    title: float = 20.0,
) -> Dict[Tuple[str, ...], Rectangle]:
    """Draw boxes around the vertices of namespaces, inner ones first.

    Args:
        groups: namespace of each vertex.
        centres: of the vertices.
        sizes: of the vertices.
        margin: between a box and what it holds.
        title: height of the line with the name.
    """
    found: Dict[Tuple[str, ...], Rectangle] = {}

    def include(group: Tuple[str, ...], part: Rectangle) -> None:
        found[group] = found[group].joined(part) if group in found else part

    for key in sorted(groups):
        if groups[key]:
            include(groups[key], around(centres[key], sizes[key]))
    for depth in range(max((len(group) for group in groups.values()), default=0), 0, -1):
        for group in sorted(each for each in found if len(each) == depth):
            inner = found[group].grown(margin)
            found[group] = inner._replace(top=inner.top - title)
            if depth > 1:
                include(group[:-1], found[group])
    return found
