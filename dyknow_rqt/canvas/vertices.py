# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ovals for nodelets and ordinary nodes, rectangles for topics."""

from __future__ import annotations

import math
from typing import Any

from python_qt_binding.QtCore import QPointF, QRectF, Qt
from python_qt_binding.QtGui import QColor, QFont, QFontMetricsF, QPainter, QPainterPath, QPen
from python_qt_binding.QtWidgets import QGraphicsItem

from dyknow.model.graph import NodeletStatus, PortRef, State
from dyknow.model.transformation import IN, OUT
from dyknow_rqt.canvas.appearance import LEAST_TEXT, Colours, Tone, height_of
from dyknow_rqt.canvas.items import PORT_RADIUS, Item, Mark, PortItem, write
from dyknow_rqt.graph.figure import Vertex, VertexKind
from dyknow_rqt.graph.geometry import Size
from dyknow_rqt.graph.measurements import Strain

#: Pixels that lines of a name may be higher than its vertex: letters leave a little room.
_OVER = 4.0
#: Pixels that a name may be wider than its vertex: over the ends of its arrows, or, in a downward
#: flow, towards its neighbours.
_BESIDE, _BETWEEN = 44.0, 24.0
#: Size of a vertex that is drawn around its name, in that of the name.
_AROUND = 1.06
#: Size of a badge, in that of the name; a name that is larger by the factor leaves no room for it.
_BADGE, _MOST = 0.8, 1.1
#: Pixels: the width of a ring, and its distance from the line.
_RING = 3.0
#: Units of an angle.
_DEGREE = 16


class VertexItem(Item):
    """A nodelet or an ordinary node (oval), or a topic (rectangle)."""

    def __init__(self, vertex: Vertex, colours: Colours, font: QFont) -> None:
        super().__init__(colours)
        self.vertex, self.key = vertex, vertex.key
        self.state = State.RUNNING
        self.is_protected = self.is_cpp = False
        self.ports: dict[str, PortItem] = {}
        self._font = font
        self._metrics = QFontMetricsF(font)
        self._height = height_of(font)
        self._cut_for, self._cut_text, self._cut_width = ("", 0.0, 0.0), "", 0.0
        self.size = Size(0, 0)
        self._is_downwards = False
        self._label = ""
        self.found = False
        self.strain = Strain()
        #: The state of the nodelet that it shows.
        self.shown: NodeletStatus | None = None
        self.setAcceptHoverEvents(True)
        self.setFlag(QGraphicsItem.ItemIsSelectable)
        self.setZValue(10)  # names of ports are read above rates

    def set_vertex(self, vertex: Vertex, size: Size, is_downwards: bool = False) -> None:
        """Change its size and ports, which are at its sides, or above and below it."""
        if (vertex, size, is_downwards) == (self.vertex, self.size, self._is_downwards):
            return
        self.vertex, self.size, self._is_downwards = vertex, size, is_downwards
        self.shown = None  # its ports may have changed
        self._label = vertex.label
        self.setRect(self.area.adjusted(-5 - _BESIDE / 2, -5, 5 + _BESIDE / 2, 5))
        wanted = {**dict.fromkeys(vertex.inputs, IN), **dict.fromkeys(vertex.outputs, OUT)}
        for name in [n for n, port in self.ports.items() if wanted.get(n) != port.direction]:
            gone = self.ports.pop(name)
            gone.setParentItem(None)
            if gone.scene() is not None:
                gone.scene().removeItem(gone)
        for side, names in ((IN, vertex.inputs), (OUT, vertex.outputs)):
            for number, name in enumerate(names):
                if name not in self.ports:
                    self.ports[name] = PortItem(PortRef(vertex.name, name), side, self._font, self)
                    self.ports[name].set_far(self.is_far)
                self.ports[name].setPos(self._port_place(number, len(names), side))

    def set_state(self, state: State, is_protected: bool = False, is_cpp: bool = False) -> None:
        looks = state, is_protected, is_cpp
        if looks != (self.state, self.is_protected, self.is_cpp):
            self.state, self.is_protected, self.is_cpp = looks
            self.look_again()

    def set_strain(self, strain: Strain) -> None:
        before, self.strain = self.strain, strain
        if (before.busy, before.error) != (strain.busy, strain.error):
            self.look_again()

    @property
    def stands_out(self) -> bool:
        return self.found or super().stands_out

    def set_far(self, is_far: bool) -> None:
        super().set_far(is_far)
        for port in self.ports.values():
            port.set_far(is_far)

    def set_colours(self, colours: Colours) -> None:
        super().set_colours(colours)
        for port in self.ports.values():
            port.set_colours(colours)

    def anchor(self, port: str, leaving: bool) -> QPointF:
        """The end of the arrows of a port, or of the vertex itself."""
        if port in self.ports:
            return self.pos() + self.ports[port].pos()
        side = 0.5 if leaving else -0.5
        width, height = self.size
        off = QPointF(0, side * height) if self._is_downwards else QPointF(side * width, 0)
        return self.pos() + off

    @property
    def area(self) -> QRectF:
        width, height = self.size
        return QRectF(-width / 2, -height / 2, width, height)

    @property
    def inked(self) -> list[QRectF]:
        """Areas that nothing else may cover, which hold it and its ports."""
        shares = [(1.0, 0.6), (0.8, 0.8), (0.6, 1.0)]  # around an ellipse
        if self.vertex.kind.is_square:
            shares = [(1.0, 1.0)]
        width, height = self.size
        areas = [
            QRectF(-across * width / 2, -down * height / 2, across * width, down * height)
            for across, down in shares
        ]
        dot = QRectF(-PORT_RADIUS, -PORT_RADIUS, 2 * PORT_RADIUS, 2 * PORT_RADIUS)
        areas += [dot.translated(port.pos()) for port in self.ports.values()]
        return [area.translated(self.pos()) for area in areas]

    def outline(self) -> QPainterPath:
        """Its shape, in the coordinates of the drawing."""
        return self.shape().translated(self.pos())

    def shape(self) -> QPainterPath:
        path = QPainterPath()
        if self.vertex.kind.is_square:
            path.addRect(self.area)
        else:
            path.addEllipse(self.area)
        return path

    def paint(self, painter: QPainter, option: Any, widget: Any = None) -> None:
        if self.mark is not None:
            self.paint_mark(painter, self.shape())
        self._paint_ring(painter)
        area = self.area
        larger = LEAST_TEXT / (self._height * painter.worldTransform().m11())
        badge, label = self._badge() if larger < _MOST else "", self._label
        if larger > 1.0:
            beside = _BETWEEN if self._is_downwards else _BESIDE
            label = self._cut((area.width() + beside) / larger, area.height() / larger)
            if self._is_downwards or self.vertex.kind.is_square:  # no ports at its sides
                most = max(0.0, self._cut_width * larger * _AROUND - area.width())
                wider = min(most, beside) / 2
                area = area.adjusted(-wider, 0, wider, 0)
        painter.setPen(self.stroke())
        painter.setBrush(self.fill())
        if self.vertex.kind.is_square:
            painter.drawRect(area)
            if self.vertex.kind is VertexKind.BOX:
                painter.drawRect(area.adjusted(-3, -3, 3, 3))
                painter.drawRect(area)
        else:
            painter.drawEllipse(area)
            if self.is_protected:
                painter.setBrush(Qt.NoBrush)
                painter.drawEllipse(area.adjusted(3, 3, -3, -3))
        painter.setFont(self._font)
        if self.tone is Tone.DROPPED:
            font = QFont(self._font)
            font.setStrikeOut(True)
            painter.setFont(font)
        painter.setPen(self._text_colour())
        write(painter, area.adjusted(0, 0, 0, -10 if badge else 0), label, max(1.0, larger))
        if badge:
            self._paint_badge(painter, badge, max(1.0, larger / _BADGE))
        if self.mark is Mark.WENT:
            painter.setPen(QPen(self.mark_colour, 2.0))
            painter.drawLine(self.area.bottomLeft(), self.area.topRight())

    @property
    def ring(self) -> tuple[QPen, float]:
        """The pen of the ring around it, and the share of the circle; 0 for no ring.

        A whole one of dots stands for errors, an arc from the top for the share of a core.
        """
        if self.strain.error:
            return QPen(self.colours.alarm, _RING, Qt.DotLine), 1.0
        return QPen(self.colours.warning, _RING, Qt.SolidLine, Qt.FlatCap), self.strain.busy

    def _paint_ring(self, painter: QPainter) -> None:
        pen, share = self.ring
        if share:
            painter.setPen(pen)
            painter.setBrush(Qt.NoBrush)
            area = self.area.adjusted(-_RING, -_RING, _RING, _RING)
            painter.drawArc(area, 90 * _DEGREE, -round(share * 360) * _DEGREE)

    def _cut(self, width: float, height: float) -> str:
        """As much of the label as there is room for; kept while that is as it was."""
        if self._cut_for != (self._label, width, height):
            metrics, title = self._metrics, self.vertex.title
            *more, least = (t.split("\n") for t in (self._label, title, title.replace("\n", "")))
            room = (height + _OVER) / metrics.height()
            lines = next((lines for lines in more if len(lines) <= room), least)
            lines = [metrics.elidedText(line, Qt.ElideMiddle, width) for line in lines]
            self._cut_for, self._cut_text = (self._label, width, height), "\n".join(lines)
            self._cut_width = max(map(metrics.horizontalAdvance, lines))
        return self._cut_text

    def _port_place(self, number: int, count: int, side: str) -> QPointF:
        width, height = self.size
        share = 2 * (number + 1) / (count + 1) - 1
        off = math.sqrt(1 - share**2) * (-1 if side == IN else 1)
        if self._is_downwards:
            share, off = off, share
        return QPointF(off * width / 2, share * height / 2)

    def stroke(self) -> QPen:
        pen = self.plain_stroke()
        if self.mark is not None and self.is_far:
            pen = QPen(self.mark_colour, 3.0)
        if self.tone is not Tone.NONE:
            pen = QPen(self.colours.of(self.tone), 2.2, pen.style())
        if self.isSelected() or self.found:
            pen = QPen(self.colours.chosen, 3.0, pen.style())
        return pen

    def plain_stroke(self) -> QPen:
        """The pen while nothing is selected or highlighted."""
        colour, width, style = self.colours.line, 1.2, Qt.SolidLine
        if self.vertex.kind is VertexKind.NODE:
            colour = self.colours.box_line
        if self.state is State.FAILED:
            colour, width = self.colours.alarm, 2.2
        elif self.state is State.LOST or self.vertex.kind is VertexKind.CLAIM:
            colour, style = self.colours.muted, Qt.DashLine
        elif self.vertex.kind is VertexKind.GHOST:
            colour, style = self.colours.text, Qt.DashLine
        elif self.state is State.STARTING:
            style = Qt.DotLine
        return QPen(colour, width, style)

    def fill(self) -> QColor:
        if self.state not in (State.RUNNING, State.STARTING):
            return self.colours.paper
        if self.tone is Tone.KEPT:
            return self.colours.kept
        if self.vertex.kind.is_square and self.vertex.kind is not VertexKind.CLAIM:
            return self.colours.topic
        is_nodelet = self.vertex.kind is VertexKind.NODELET
        return self.colours.nodelet if is_nodelet else self.colours.paper

    def _text_colour(self) -> Any:
        if self.tone is not Tone.NONE:
            return self.colours.of(self.tone)
        if self.state is State.FAILED:
            return self.colours.alarm
        quiet = self.vertex.kind is VertexKind.NODE or self.state is State.LOST
        return self.colours.muted if quiet else self.colours.text

    def _badge(self) -> str:
        if self.vertex.kind is not VertexKind.NODELET:
            return ""
        words = ["C++"] if self.is_cpp else []
        words += ["protected"] if self.is_protected else []
        words += [self.state.name.lower()] if self.state is not State.RUNNING else []
        return " · ".join(words)

    def _paint_badge(self, painter: QPainter, text: str, larger: float) -> None:
        font = QFont(self._font)
        font.setPointSizeF(self._font.pointSizeF() * _BADGE)
        painter.setFont(font)
        alarm = self.state is State.FAILED
        painter.setPen(self.colours.alarm if alarm else self.colours.muted)
        lines = self._label.count("\n") + 1
        top = self._metrics.height() * lines / 2 - 5
        write(painter, QRectF(self.area.left(), top, self.area.width(), 13), text, larger)
