# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Places the labels of arrows where they overprint nothing."""

from __future__ import annotations

from typing import Dict, Iterable, Iterator, List, Mapping, Sequence, Tuple

from dyknow_rqt.graph.figure import Edge
from dyknow_rqt.graph.geometry import Point, Rectangle, Size, around

#: Pieces that each part of a curve is cut into; a label may stand beside the end of each.
_PIECES = 8
#: Where a label may stand beside a point of its curve: shares of its width and height that its
#: centre is off, and what is better first. A steep curve would run through one that is centred.
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
    sizes: Mapping[Edge, Size],
    obstacles: Iterable[Rectangle],
) -> Dict[Edge, Rectangle]:
    """Place labels beside their curves, as near to the middle as there is room.

    Args:
        curves: control points of cubic Bézier curves, 3 n + 1 of them.
        sizes: of the labels.
        obstacles: what labels must not cover, besides curves and each other.

    Returns:
        The areas of the labels; those that find no room are left out.
    """
    paths = {edge: list(_points(curve)) for edge, curve in curves.items()}
    ground = _Ground()
    for area in obstacles:
        ground.take(area)
    for path in paths.values():
        for start, end in zip(path, path[1:]):
            ground.take(_between(start, end))
    places = {}
    for edge in sorted(sizes):
        for area in _candidates(paths[edge], sizes[edge]):
            if ground.is_free(area):
                places[edge] = area
                ground.take(area)
                break
    return places


def _candidates(path: List[Point], size: Size) -> Iterator[Rectangle]:
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


def _between(start: Point, end: Point) -> Rectangle:
    (a, b), (c, d) = start, end
    return Rectangle(min(a, c), min(b, d) - 0.5, max(a, c), max(b, d) + 0.5)


class _Ground:
    """Areas that are taken, by the squares that they touch."""

    def __init__(self) -> None:
        self._taken: Dict[Tuple[int, int], List[Rectangle]] = {}

    def take(self, area: Rectangle) -> None:
        for cell in self._cells(area):
            self._taken.setdefault(cell, []).append(area)

    def is_free(self, area: Rectangle) -> bool:
        return not any(
            area.meets(other) for cell in self._cells(area) for other in self._taken.get(cell, ())
        )

    def _cells(self, area: Rectangle) -> List[Tuple[int, int]]:
        left, top, right, bottom = (int(side // _CELL) for side in area)
        return [
            (column, row) for column in range(left, right + 1) for row in range(top, bottom + 1)
        ]
