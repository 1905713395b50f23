# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Colours of the drawing, derived from the palette, so that dark themes work."""

from __future__ import annotations

import enum
from typing import NamedTuple

from python_qt_binding.QtGui import QColor, QPalette


class Tone(enum.Enum):
    """The relation of an item to the one under the pointer."""

    NONE = "none"
    SELF = "self"
    IN = "in"
    OUT = "out"
    BOTH = "both"


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
    chosen: QColor
    paper: QColor
    self_: QColor
    in_: QColor
    out: QColor
    both: QColor

    def of(self, tone: Tone) -> QColor:
        """The colour of a highlighted item."""
        return {
            Tone.SELF: self.self_,
            Tone.IN: self.in_,
            Tone.OUT: self.out,
            Tone.BOTH: self.both,
        }.get(tone, self.line)


def colours_of(palette: QPalette) -> Colours:
    """Derive the colours from a palette."""
    paper, text = palette.color(QPalette.Base), palette.color(QPalette.Text)
    dark = paper.lightness() < text.lightness()
    chosen = palette.color(QPalette.Highlight)
    return Colours(
        line=_mix(text, paper, 0.25),
        text=text,
        nodelet=_mix(paper, chosen, 0.10),
        topic=_mix(paper, text, 0.05),
        box=_mix(paper, text, 0.025),
        box_line=_mix(paper, text, 0.35),
        muted=_mix(text, paper, 0.38),
        alarm=QColor("#ff6b61") if dark else QColor("#c62015"),
        chosen=chosen,
        paper=paper,
        # These differ for every kind of colour blindness, also from the line.
        self_=QColor("#e76129") if dark else QColor("#d52401"),
        in_=QColor("#6d7ef7") if dark else QColor("#0018c8"),
        out=QColor("#3cd380") if dark else QColor("#1a8060"),
        both=QColor("#c983c8") if dark else QColor("#c906b3"),
    )


def greys_of(palette: QPalette) -> Colours:
    """The colours of a drawing that may no longer be true."""
    colours = colours_of(palette)
    muted, line, paper = colours.muted, colours.box_line, colours.paper
    return colours._replace(
        line=line, text=muted, nodelet=paper, topic=paper, box=paper, alarm=muted
    )


def _mix(one: QColor, other: QColor, share: float) -> QColor:
    """A colour between two, ``share`` of the way to the other."""
    parts = zip(one.getRgb()[:3], other.getRgb()[:3])
    return QColor(*(int(a + (b - a) * share) for a, b in parts))
