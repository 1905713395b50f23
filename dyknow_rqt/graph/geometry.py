# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Layouts: places of vertices, curves, boxes and labels, as values; those that the user chose."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass, field
from typing import Iterable, Iterator, Mapping, NamedTuple, Sequence

from dyknow_rqt.graph.figure import Edge, Figure


class Point(NamedTuple):
    """A place or a displacement."""

    x: float
    y: float

    def plus(self, other: Point) -> Point:
        return Point(self.x + other.x, self.y + other.y)

    def minus(self, other: Point) -> Point:
        return Point(self.x - other.x, self.y - other.y)

    @property
    def turned(self) -> Point:
        """With x and y swapped."""
        return Point(self.y, self.x)

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
        left, top, right, bottom = self
        return Rectangle(left - margin, top - margin, right + margin, bottom + margin)

    def joined(self, other: Rectangle) -> Rectangle:
        return Rectangle(
            min(self.left, other.left),
            min(self.top, other.top),
            max(self.right, other.right),
            max(self.bottom, other.bottom),
        )

    @property
    def sides(self) -> tuple[Rectangle, ...]:
        left, top, right, bottom = self
        return (
            Rectangle(left - 1, top, left + 1, bottom),
            Rectangle(right - 1, top, right + 1, bottom),
            Rectangle(left, top - 1, right, top + 1),
            Rectangle(left, bottom - 1, right, bottom + 1),
        )

    def meets(self, other: Rectangle) -> bool:
        return (
            self.left < other.right
            and other.left < self.right
            and self.top < other.bottom
            and other.top < self.bottom
        )


def around(centre: Point, size: Size) -> Rectangle:
    x, y = centre
    return Rectangle(
        x - size.width / 2, y - size.height / 2, x + size.width / 2, y + size.height / 2
    )


@dataclass(frozen=True)
class Layout:
    """Centres of vertices, boxes, and curves from tail to head.

    Curves have the control points of cubic Bézier curves, 3 n + 1 of them.
    """

    centres: Mapping[str, Point] = field(default_factory=dict)
    curves: Mapping[Edge, tuple[Point, ...]] = field(default_factory=dict)
    boxes: Mapping[tuple[str, ...], Rectangle] = field(default_factory=dict)

    def turned(self) -> Layout:
        """Swap x and y: from left to right becomes from top to bottom; it has no boxes then."""
        return Layout(
            {key: place.turned for key, place in self.centres.items()},
            {edge: tuple(each.turned for each in curve) for edge, curve in self.curves.items()},
        )

    def moved(self, by: Point) -> Layout:
        """Move everything; it has no boxes then."""
        return self.put_at({key: place.plus(by) for key, place in self.centres.items()})

    def put_at(self, places: Mapping[str, Point]) -> Layout:
        """Move vertices to their places; it has no boxes then.

        Arrows whose two ends move alike go along, the rest are left out.
        """
        ways = {k: places[k].minus(place) for k, place in self.centres.items() if k in places}
        curves, still = {}, Point(0.0, 0.0)
        for edge, curve in self.curves.items():
            tail, head = ways.get(edge.tail, still), ways.get(edge.head, still)
            if tail.distance(head) < 1.0:
                curves[edge] = tuple(place.plus(tail) for place in curve)
        return Layout({key: places.get(key, each) for key, each in self.centres.items()}, curves)


@dataclass(frozen=True)
class Drawing:
    """A figure, whose ports are in an order without crossings, with sizes and places.

    One that is made anew is made without regard to the drawing before.
    """

    figure: Figure = field(default_factory=Figure)
    sizes: Mapping[str, Size] = field(default_factory=dict)
    layout: Layout = field(default_factory=Layout)
    is_anew: bool = False


def curve_between(tail: Point, tail_size: Size, head: Point, head_size: Size) -> tuple[Point, ...]:
    """Lead an arrow from the right end of one vertex to the left end of another."""
    start = Point(tail.x + tail_size.width / 2, tail.y)
    end = Point(head.x - head_size.width / 2, head.y)
    reach = max(40.0, min(150.0, abs(end.x - start.x) / 2))
    return start, Point(start.x + reach, start.y), Point(end.x - reach, end.y), end


def boxes_around(
    groups: Mapping[str, tuple[str, ...]],
    centres: Mapping[str, Point],
    sizes: Mapping[str, Size],
    is_turned: bool = False,
) -> dict[tuple[str, ...], Rectangle]:
    """Draw boxes around the vertices of namespaces; above the contents is a line for the title.

    ``is_turned`` says that x and y are swapped.
    """
    margin, title = 8.0, 20.0
    found: dict[tuple[str, ...], Rectangle] = {}

    def include(group: tuple[str, ...], part: Rectangle) -> None:
        found[group] = found[group].joined(part) if group in found else part

    for key in sorted(groups):
        if groups[key]:
            include(groups[key], around(centres[key], sizes[key]))
    for depth in range(max((len(group) for group in groups.values()), default=0), 0, -1):
        for group in sorted(each for each in found if len(each) == depth):
            inner = found[group].grown(margin)
            if is_turned:
                found[group] = inner._replace(left=inner.left - title)
            else:
                found[group] = inner._replace(top=inner.top - title)
            if depth > 1:
                include(group[:-1], found[group])
    return found


#: Pieces that each part of a curve is cut into; a label may stand beside the end of each.
_PIECES = 16
#: Where a label may stand beside a point of its curve: shares of its width and height that its
#: centre is off, and the better one first. A steep curve would run through one that is centred.
_SIDES = (
    *((0.0, -0.5, 0.0), (0.5, -0.5, 1.0), (-0.5, -0.5, 1.0)),
    *((0.0, 0.5, 1.5), (0.5, 0.5, 2.5), (-0.5, 0.5, 2.5)),
)
#: Pixels between a label and its curve.
_GAP = 2.0
#: Pixels of the squares in which neighbours are looked up.
_CELL = 32.0


def place_labels(
    curves: Mapping[Edge, Sequence[Point]],
    sizes: Mapping[Edge, Sequence[Size]],
    obstacles: Iterable[Rectangle],
) -> dict[Edge, Rectangle]:
    """Place labels beside their curves, as near to the middle as there is room.

    Those without room are left out. A label has one of its sizes, the best first; the tallest
    labels, which have most to say, are placed first. None covers an obstacle, a curve or another.
    """
    paths = {edge: list(_points(curve)) for edge, curve in curves.items()}
    ground = _Ground()
    for area in obstacles:
        ground.take(area)
    for path in paths.values():
        for (a, b), (c, d) in zip(path, path[1:]):
            ground.take(Rectangle(min(a, c), min(b, d) - 0.5, max(a, c), max(b, d) + 0.5))
    places = {}
    for edge in sorted(sizes, key=lambda edge: (-sizes[edge][0].height, edge)):
        if not any(map(ground.is_free, _candidates(paths[edge], sizes[edge][-1]))):
            continue  # a larger one would cover all that the smallest does
        areas = (area for size in sizes[edge] for area in _candidates(paths[edge], size))
        places[edge] = next(filter(ground.is_free, areas))
        ground.take(places[edge])
    return places


def _candidates(path: list[Point], size: Size) -> Iterator[Rectangle]:
    """Areas beside the curve, above it and near its middle first."""
    middle = len(path) // 2
    places = (
        (abs(number - middle) / middle * 2.0 + cost, point, across, down)
        for number, point in enumerate(path)
        for across, down, cost in _SIDES
    )
    for _, (x, y), across, down in sorted(places):
        centre = Point(x + across * (size.width + 2 * _GAP), y + down * (size.height + 2 * _GAP))
        yield around(centre, size)


def _points(curve: Sequence[Point]) -> Iterator[Point]:
    yield Point(*curve[0])
    for a, b, c, d in zip(curve[::3], curve[1::3], curve[2::3], curve[3::3]):
        for number in range(1, _PIECES + 1):
            t = number / _PIECES
            u = 1 - t
            p, q, r, s = u * u * u, 3 * u * u * t, 3 * u * t * t, t * t * t
            yield Point(
                p * a[0] + q * b[0] + r * c[0] + s * d[0],
                p * a[1] + q * b[1] + r * c[1] + s * d[1],
            )


class _Ground:
    """Areas that are taken, by the squares that they touch."""

    def __init__(self) -> None:
        self._taken: dict[tuple[int, int], list[Rectangle]] = {}

    def take(self, area: Rectangle) -> None:
        for cell in self._cells(area):
            self._taken.setdefault(cell, []).append(area)

    def is_free(self, area: Rectangle) -> bool:
        return not any(
            area.meets(other) for cell in self._cells(area) for other in self._taken.get(cell, ())
        )

    def _cells(self, area: Rectangle) -> list[tuple[int, int]]:
        left, top, right, bottom = (int(side // _CELL) for side in area)
        return [
            (column, row) for column in range(left, right + 1) for row in range(top, bottom + 1)
        ]


#: The most wirings whose places are kept.
_MOST = 20


class Places:
    """Where the user has put vertices, for each wiring, known by the names of its nodelets.

    A wiring that was not seen before takes over the places of the one before it.
    """

    def __init__(self) -> None:
        self.present: dict[str, Point] = {}
        self._wiring = ""
        self._kept: dict[str, dict[str, Point]] = {}

    def follow(self, nodelets: Iterable[str]) -> None:
        """Turn to the wiring of these nodelets."""
        wiring = f"{zlib.crc32(' '.join(sorted(nodelets)).encode()):08x}"
        if wiring != self._wiring:
            self._wiring = wiring
            self.present = dict(self._kept.get(wiring, self.present))

    def put(self, places: Mapping[str, Point]) -> None:
        self.present.update(places)
        self._keep()

    def forget(self) -> None:
        """Forget all places of the present wiring."""
        self.present.clear()
        self._keep()

    def to_text(self) -> str:
        if self.present:
            self._keep()  # also what was taken over
        kept = {wiring: places for wiring, places in self._kept.items() if places}
        return json.dumps(kept) if kept else ""

    def read(self, text: str) -> None:
        """Read what ``to_text`` wrote; a text that is not that is ignored."""
        try:
            self._kept = {
                str(wiring): {str(key): Point(float(x), float(y)) for key, (x, y) in each.items()}
                for wiring, each in json.loads(text or "{}").items()
            }
        except (AttributeError, TypeError, ValueError):
            return
        self.present = dict(self._kept.get(self._wiring, {}))

    def _keep(self) -> None:
        self._kept.pop(self._wiring, None)
        self._kept[self._wiring] = dict(self.present)
        for wiring in list(self._kept)[:-_MOST]:
            del self._kept[wiring]
