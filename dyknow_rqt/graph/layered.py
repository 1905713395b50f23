# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A simple layout in layers, used if graphviz is missing or too slow."""

from __future__ import annotations

from typing import Dict, List, Mapping, Set, Tuple

from dyknow_rqt.graph.figure import Figure
from dyknow_rqt.graph.geometry import Layout, Point, Size, boxes_around, curve_between

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
