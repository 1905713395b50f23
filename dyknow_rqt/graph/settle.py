"""Keeps a drawing where it is when a part of it changes.

graphviz begins anew each time: one nodelet more can move all others. Where it would move more than
a few, what was there stays, and only what is new, or had no connection yet, takes a place beside
its neighbours.
"""

from __future__ import annotations

from statistics import median
from typing import Dict, List, Mapping

from dyknow_rqt.graph.figure import Figure
from dyknow_rqt.graph.geometry import (
    Layout,
    Point,
    Rectangle,
    Size,
    around,
    boxes_around,
    curve_between,
)

#: So many may move when something is added or removed.
MOST_MOVED = 4
#: Pixels that nobody takes for a move.
STILL = 8.0
_GAP = 14.0
_TRIES = 200


def settle(
    old: Layout, before: Figure, new: Layout, after: Figure, sizes: Mapping[str, Size]
) -> Layout:
    """Bring a new layout as near to the old one as its looks allow.

    Args:
        old: what is on the screen.
        before: the figure of it.
        new: what graphviz says of the figure to come.
        after: the figure to come.
        sizes: of its vertices.
    """
    common = sorted(set(old.centres) & set(new.centres))
    if not common:
        return new
    shift = Point(
        median(old.centres[key].x - new.centres[key].x for key in common),
        median(old.centres[key].y - new.centres[key].y for key in common),
    )
    fresh = new.moved(shift)
    if len(moved(old, fresh)) <= MOST_MOVED or len(common) < len(after.vertices) / 2:
        return fresh
    connected = before.neighbours()
    free = [key for key in common if not connected[key] and after.neighbours()[key]]
    kept = {key: old.centres[key] for key in common if key not in free}
    centres = _place(kept, fresh, after, sizes)
    boxes = boxes_around({v.key: v.group for v in after.vertices}, centres, sizes)
    if _strangers(after, centres, sizes, boxes):
        return fresh
    return Layout(centres, _curves(fresh, centres, after, sizes), boxes)


def moved(old: Layout, new: Layout) -> List[str]:
    """Vertices of both layouts that stand elsewhere in the new one."""
    return [
        key
        for key in sorted(set(old.centres) & set(new.centres))
        if old.centres[key].distance(new.centres[key]) > STILL
    ]


def _place(
    kept: Mapping[str, Point], fresh: Layout, after: Figure, sizes: Mapping[str, Size]
) -> Dict[str, Point]:
    """Find free places for what is not kept, from left to right."""
    centres = dict(kept)
    taken = {key: around(place, sizes[key]) for key, place in centres.items()}
    neighbours = after.neighbours()
    for key in sorted(set(fresh.centres) - set(kept), key=lambda key: (fresh.centres[key], key)):
        placed = sorted(neighbours[key] & set(centres))
        wish = fresh.centres[key]
        if placed:
            offsets = [centres[n].minus(fresh.centres[n]) for n in placed]
            wish = wish.plus(
                Point(
                    sum(o.x for o in offsets) / len(offsets),
                    sum(o.y for o in offsets) / len(offsets),
                )
            )
        centres[key] = _free_place(wish, sizes[key], list(taken.values()))
        taken[key] = around(centres[key], sizes[key])
    return centres


def _free_place(wish: Point, size: Size, taken: List[Rectangle]) -> Point:
    step = size.height / 2 + _GAP
    for attempt in range(_TRIES):
        way = (attempt + 1) // 2 * step * (1 if attempt % 2 else -1)
        place = Point(wish.x, wish.y + way)
        if not any(around(place, size).grown(_GAP / 2).meets(other) for other in taken):
            return place
    return wish


def _strangers(
    after: Figure,
    centres: Mapping[str, Point],
    sizes: Mapping[str, Size],
    boxes: Mapping[tuple, Rectangle],  # type: ignore[type-arg]
) -> bool:
    """Whether something stands in the box of a namespace that it does not belong to."""
    groups = sorted(boxes)
    return any(
        boxes[group].meets(around(centres[v.key], sizes[v.key]))
        for group in groups
        for v in after.vertices
        if v.group[: len(group)] != group
    ) or any(
        boxes[one].meets(boxes[other])
        for one in groups
        for other in groups
        if one < other and other[: len(one)] != one
    )


def _curves(
    fresh: Layout, centres: Mapping[str, Point], after: Figure, sizes: Mapping[str, Size]
) -> dict:  # type: ignore[type-arg]
    """Take over the curves whose two ends moved alike; lead the others anew."""
    curves = {}
    for edge in after.edges:
        tail = centres[edge.tail].minus(fresh.centres[edge.tail])
        head = centres[edge.head].minus(fresh.centres[edge.head])
        if tail.distance(head) < 1.0:
            curves[edge] = tuple(place.plus(tail) for place in fresh.curves[edge])
        else:
            curves[edge] = curve_between(
                centres[edge.tail], sizes[edge.tail], centres[edge.head], sizes[edge.head]
            )
    return curves
