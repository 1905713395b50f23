# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Makes a drawing of what graphviz answers for a figure, or without it."""

from __future__ import annotations

from dataclasses import replace
from typing import Mapping, Optional, Tuple

from dyknow_rqt.graph.dot import BadLayout, read_layout
from dyknow_rqt.graph.figure import Figure
from dyknow_rqt.graph.geometry import Drawing, Layout, Size, boxes_around
from dyknow_rqt.graph.layered import layered
from dyknow_rqt.graph.port_order import without_crossings
from dyknow_rqt.graph.stabilise import stabilise


def arranged(
    figure: Figure, sizes: Mapping[str, Size], answer: bytes, before: Optional[Drawing] = None
) -> Tuple[Drawing, str]:
    """Place the parts of a figure.

    All but graphviz works from left to right, and what is to flow downwards is turned for that.

    Args:
        figure: what to draw.
        sizes: of its vertices.
        answer: what graphviz says.
        before: what is on the screen; None to make a drawing without regard to it.

    Returns:
        The drawing, and why a simpler layout had to be used; empty if that was not so.
    """
    is_turned, complaint = figure.is_downwards, ""
    widths = {key: Size(*size[::-1]) for key, size in sizes.items()} if is_turned else sizes
    try:
        layout = _turned(read_layout(answer.decode("utf-8", "replace"), figure), is_turned)
    except BadLayout as error:
        layout, complaint = layered(figure, widths), f"graphviz: {error}"
    if before is not None and before.figure.is_downwards == is_turned:
        old = _turned(before.layout, is_turned)
        layout = stabilise(old, before.figure, layout, figure, widths)
    vertices = tuple(without_crossings(figure, layout))
    if is_turned:
        layout = _turned(layout, is_turned)
        groups = {vertex.key: vertex.group for vertex in vertices}
        layout = replace(layout, boxes=boxes_around(groups, layout.centres, sizes))
    drawing = Drawing(replace(figure, vertices=vertices), sizes, layout, before is None)
    return drawing, complaint


def _turned(layout: Layout, is_turned: bool) -> Layout:
    return layout.turned() if is_turned else layout
