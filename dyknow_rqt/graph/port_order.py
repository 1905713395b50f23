# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The order of ports on a nodelet, so that their arrows do not cross."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, List, Sequence, Tuple

from dyknow_rqt.graph.figure import Figure, Vertex
from dyknow_rqt.graph.geometry import Layout


def without_crossings(figure: Figure, layout: Layout) -> List[Vertex]:
    """Sort the ports, from top to bottom, by their arrows.

    Ports without an arrow keep their places; the others change places among themselves.
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
