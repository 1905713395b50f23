# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The looks of vertices and arrows: tones, colours, fonts, signs."""

from __future__ import annotations

import enum
from functools import lru_cache
from typing import NamedTuple

from python_qt_binding.QtGui import QColor, QFont, QFontMetricsF, QPalette

from dyknow.formulas import Truth
from dyknow_rqt.graph.figure import Edge, Figure
from dyknow_rqt.graph.geometry import Size


class Tone(enum.Enum):
    """The relation of an item to the one under the pointer, or to the plan that is shown."""

    NONE = "none"
    SELF = "self"
    IN = "in"
    OUT = "out"
    BOTH = "both"
    KEPT = "kept"
    DROPPED = "dropped"


def tones_around(figure: Figure, thing: str | Edge) -> dict[object, Tone]:
    """The tones of a vertex, by its key, and its neighbours, or of an arrow and its ends."""
    if isinstance(thing, Edge):
        return {thing: Tone.SELF, thing.tail: Tone.IN, thing.head: Tone.OUT}
    tones: dict[object, Tone] = {}
    for edge in figure.edges:
        head, tail = edge.head, edge.tail
        for own, other, side in ((head, tail, Tone.IN), (tail, head, Tone.OUT)):
            for each in (edge, other) if own == thing else ():
                tones[each] = side if tones.get(each, side) is side else Tone.BOTH
    return {**tones, thing: Tone.SELF}


class Colours(NamedTuple):
    """The colours of the items."""

    line: QColor
    text: QColor
    nodelet: QColor
    topic: QColor
    box: QColor
    box_line: QColor
    muted: QColor
    alarm: QColor
    warning: QColor
    chosen: QColor
    paper: QColor
    self_: QColor
    in_: QColor
    out: QColor
    both: QColor
    kept: QColor
    true: QColor
    false: QColor

    def of_truth(self, truth: Truth) -> QColor:
        """The colour of a verdict."""
        return {Truth.TRUE: self.true, Truth.FALSE: self.false}.get(truth, self.line)

    def of(self, tone: Tone) -> QColor:
        """The colour of a highlighted item."""
        return {
            Tone.SELF: self.self_,
            Tone.IN: self.in_,
            Tone.OUT: self.out,
            Tone.BOTH: self.both,
            Tone.KEPT: self.out,
            Tone.DROPPED: self.muted,
        }.get(tone, self.line)


def colours_of(palette: QPalette) -> Colours:
    """Derive the colours from a palette."""
    paper, text = palette.color(QPalette.Base), palette.color(QPalette.Text)
    dark = paper.lightness() < text.lightness()
    chosen = palette.color(QPalette.Highlight)
    red = QColor("#e76129") if dark else QColor("#d52401")
    green = QColor("#3cd380") if dark else QColor("#1a8060")
    return Colours(
        line=_mix(text, paper, 0.25),
        text=text,
        nodelet=_mix(paper, chosen, 0.10),
        topic=_mix(paper, text, 0.05),
        box=_mix(paper, text, 0.025),
        box_line=_mix(paper, text, 0.35),
        muted=_mix(text, paper, 0.38),
        alarm=QColor("#ff6b61") if dark else QColor("#c62015"),
        warning=QColor("#f2c14e") if dark else QColor("#dc7d00"),
        chosen=chosen,
        paper=paper,
        # These differ for every kind of colour blindness, also from the line.
        self_=red,
        in_=QColor("#6d7ef7") if dark else QColor("#0018c8"),
        out=green,
        both=QColor("#c983c8") if dark else QColor("#c906b3"),
        kept=_mix(paper, green, 0.25),
        true=green,
        false=red,
    )


def greys_of(palette: QPalette) -> Colours:
    """The colours of a drawing that may no longer be true."""
    colours = colours_of(palette)
    papers = dict.fromkeys(("nodelet", "topic", "box"), colours.paper)
    greys = dict.fromkeys(("text", "alarm", "warning", "true", "false"), colours.muted)
    return colours._replace(line=colours.box_line, **papers, **greys)


def _mix(one: QColor, other: QColor, share: float) -> QColor:
    """A colour between two, ``share`` of the way to the other."""
    parts = zip(one.getRgb()[:3], other.getRgb()[:3])
    return QColor(*(int(a + (b - a) * share) for a, b in parts))


_PORT_PITCH = 15.0
#: Pixels of the least text that is written.
LEAST_TEXT = 9.0
#: A rate is written so much larger where it would be too small to read, if there is room.
ROOM = 1.4
#: Stands for all usual numbers, so that the room for one does not depend on its value.
NUMBER = "000"


def sizes_of(figure: Figure, font: QFont) -> dict[str, Size]:
    """Sizes of vertices with room for their names and ports."""
    key, sizes = font.key(), {}
    for vertex in figure.vertices:
        width, height = _size_of_text(key, vertex.label)
        if vertex.kind.is_square:
            sizes[vertex.key] = Size(width * 1.1 + 16, height + 8)
        else:
            room = _PORT_PITCH * (max(len(vertex.inputs), len(vertex.outputs)) + 1)
            wide, tall = width * 1.15 + 26, height + 26
            sizes[vertex.key] = (
                Size(max(wide, room), tall) if figure.is_downwards else Size(wide, max(tall, room))
            )
    return sizes


@lru_cache(maxsize=20_000)
def _size_of_text(font_key: str, text: str) -> Size:
    font = QFont()
    font.fromString(font_key)
    metrics, lines = QFontMetricsF(font), text.split("\n")
    width = max(metrics.horizontalAdvance(line) for line in lines)
    return Size(width, metrics.height() * len(lines))


def gap_of(font: QFont) -> float:
    """Room for a rate on an arrow, in pixels."""
    return float(QFontMetricsF(font).horizontalAdvance(f"{NUMBER} Hz")) * ROOM + 14


def height_of(font: QFont) -> float:
    """The size of its letters, in pixels."""
    return float(font.pixelSize() if font.pixelSize() > 0 else QFontMetricsF(font).ascent())
