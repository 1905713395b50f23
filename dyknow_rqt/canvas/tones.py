# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The relation of an item to the one under the pointer, or to the plan that is shown."""

from __future__ import annotations

import enum
from typing import Dict, Union

from dyknow_rqt.graph.figure import Edge, Figure


class Tone(enum.Enum):
    """The relation of an item to the one under the pointer, or to the plan that is shown."""

    NONE = "none"
    SELF = "self"
    IN = "in"
    OUT = "out"
    BOTH = "both"
    KEPT = "kept"
    DROPPED = "dropped"


def tones_around(figure: Figure, thing: Union[str, Edge]) -> Dict[object, Tone]:
    """The tones of a vertex, by its key, and its neighbours, or of an arrow and its ends."""
    if isinstance(thing, Edge):
        return {thing: Tone.SELF, thing.tail: Tone.IN, thing.head: Tone.OUT}
    tones: Dict[object, Tone] = {}
    for edge in figure.edges:
        head, tail = edge.head, edge.tail
        for own, other, side in ((head, tail, Tone.IN), (tail, head, Tone.OUT)):
            for each in (edge, other) if own == thing else ():
                tones[each] = side if tones.get(each, side) is side else Tone.BOTH
    return {**tones, thing: Tone.SELF}
