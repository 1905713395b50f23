# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Keeps a drawing where it is when a part of it changes.

graphviz computes each layout from nothing: one more nodelet can move the whole drawing. If it
would move more than a few vertices, the old places are kept, and only new vertices, or those that
had no connection before, are placed beside their neighbours. If that turns arrows backwards
without need, or if much has changed, the new layout is used as it is.
"""

from __future__ import annotations

from statistics import fmean, median
from typing import Mapping, Sequence

from dyknow_rqt.graph.figure import Figure, Vertex, VertexKind
from dyknow_rqt.graph.geometry import Layout, Point, Rectangle, Size, around, boxes_around

#: So many vertices may move when something is added or removed.
MOST_MOVED = 4
#: If at most so many nodelets come or go, the rest keep their places.
FEW = 2
#: At most so many new vertices are placed one by one; with more the new layout is used.
MOST_PLACED = 12
#: Pixels; a shorter distance does not count as a move.
STILL = 8.0
_GAP = 14.0
#: Steps up and down that are tried for a new vertex.
_TRIES = 10


def stabilise(
    old: Layout,
    before: Figure,
    new: Layout,
    after: Figure,
    sizes: Mapping[str, Size],
    taken: Sequence[Rectangle] = (),
) -> Layout:
    """Move the vertices of a new layout to their old places on the screen, if that looks well.

    Nothing is placed where something else is that has ``taken`` its place. Arrows whose ends do
    not move alike are left out.
    """
    common = sorted(set(old.centres) & set(new.centres))
    shift = Point(
        median(old.centres[key].x - new.centres[key].x for key in common),
        median(old.centres[key].y - new.centres[key].y for key in common),
    )
    fresh = new.moved(shift)
    if len(moved(old, fresh)) <= MOST_MOVED or len(common) < len(after.vertices) / 2:
        return fresh
    had, have = before.neighbours(), after.neighbours()
    free = [key for key in common if not had[key] and have[key]]
    if len(after.vertices) - len(common) + len(free) > MOST_PLACED:
        return fresh
    kept = {key: old.centres[key] for key in common if key not in free}
    centres = _place(kept, fresh, after, sizes, taken)
    if _strangers(after.vertices, centres, sizes):
        return fresh
    if not 1 <= len(_nodelets(before) ^ _nodelets(after)) <= FEW and (
        backwards(centres, after, sizes) > backwards(fresh.centres, after, sizes)
    ):
        return fresh
    return fresh.put_at(centres)


def moved(old: Layout, new: Layout) -> list[str]:
    """The vertices that have another place in the new layout."""
    return [
        key
        for key in sorted(set(old.centres) & set(new.centres))
        if old.centres[key].distance(new.centres[key]) > STILL
    ]


def backwards(centres: Mapping[str, Point], figure: Figure, sizes: Mapping[str, Size]) -> int:
    """Count the arrows that do not point to the right."""
    return sum(
        centres[edge.tail].x + sizes[edge.tail].width / 2
        > centres[edge.head].x - sizes[edge.head].width / 2
        for edge in figure.edges
    )


def _nodelets(figure: Figure) -> set[str]:
    return {vertex.key for vertex in figure.vertices if vertex.kind is VertexKind.NODELET}


def _place(
    kept: Mapping[str, Point],
    fresh: Layout,
    after: Figure,
    sizes: Mapping[str, Size],
    others: Sequence[Rectangle],
) -> dict[str, Point]:
    """Find free places for the vertices that are not kept, from left to right."""
    centres = dict(kept)
    neighbours = after.neighbours()
    vertices = {vertex.key: vertex for vertex in after.vertices}

    def free_place(vertex: Vertex, wish: Point) -> Point:
        """Find one near the wanted one whose box does not grow into other boxes."""
        taken = {key: around(place, sizes[key]) for key, place in centres.items()}
        groups = {key: vertices[key].group for key in centres}
        boxes = boxes_around(groups, centres, sizes)
        home = vertex.group[:1]
        foreign = [box for group, box in boxes.items() if vertex.group[: len(group)] != group]
        foreign += [area for key, area in taken.items() if groups[key][:1] != home]
        foreign += others
        own, nearest = boxes.get(home), None
        step = sizes[vertex.key].height / 2 + _GAP
        for number in sorted(range(-_TRIES, _TRIES + 1), key=abs):
            place = wish.plus(Point(0.0, number * step))
            area = around(place, sizes[vertex.key]).grown(_GAP / 2)
            if any(area.meets(each) for each in (*taken.values(), *others)):
                continue
            nearest = nearest or place
            reach = area if own is None else own.joined(area)
            if not any(reach.meets(each) for each in foreign):
                return place
        return nearest or wish

    for key in sorted(set(fresh.centres) - set(kept), key=lambda key: (fresh.centres[key], key)):
        wish = fresh.centres[key]
        placed = sorted(neighbours[key] & set(centres))
        if placed:
            offsets = [centres[n].minus(fresh.centres[n]) for n in placed]
            wish = wish.plus(Point(fmean(o.x for o in offsets), fmean(o.y for o in offsets)))
        centres[key] = free_place(vertices[key], wish)
    return centres


def _strangers(
    vertices: Sequence[Vertex], centres: Mapping[str, Point], sizes: Mapping[str, Size]
) -> bool:
    """Whether a vertex is in the box of another namespace, or two boxes overlap."""
    boxes = boxes_around({v.key: v.group for v in vertices}, centres, sizes)
    inner = {(*v.group, v.key): around(centres[v.key], sizes[v.key]) for v in vertices}
    return any(
        box.meets(area)
        for group, box in boxes.items()
        for other, area in (*boxes.items(), *inner.items())
        if group[: len(other)] != other and other[: len(group)] != group
    )
