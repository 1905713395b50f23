# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Arrows and their rates."""

from __future__ import annotations

import math
import re
from typing import Any, Optional, Sequence

from python_qt_binding.QtCore import QPointF, QRectF, Qt
from python_qt_binding.QtGui import (
    QBrush,
    QFont,
    QFontMetricsF,
    QPainter,
    QPainterPath,
    QPainterPathStroker,
    QPen,
    QPolygonF,
)
from python_qt_binding.QtWidgets import QGraphicsItem

from dyknow.formulas import Truth
from dyknow_rqt.background_calls import qt_slot
from dyknow_rqt.canvas.appearance import RATE_SCALE, Colours, Tone
from dyknow_rqt.canvas.items import PORT_RADIUS, Item, rectangle_of
from dyknow_rqt.graph.figure import Edge, edge_refs
from dyknow_rqt.graph.geometry import Point, Rectangle, Size
from dyknow_rqt.graph.rates import PortRate
from dyknow_rqt.graph.verdicts import PortVerdict

_ARROW = 8.0
#: Zoom below which a rate could not be read.
_LEAST = 0.4
_DASHES = {Truth.TRUE: Qt.SolidLine, Truth.FALSE: Qt.DashLine, Truth.UNKNOWN: Qt.DotLine}
_NUMBER = re.compile(r"[\d.]+")


class EdgeItem(Item):
    """An arrow with its rate, and the last verdict that came along it."""

    def __init__(self, edge: Edge, colours: Colours, font: QFont) -> None:
        super().__init__(colours)
        self.edge = edge
        #: The ports at its ends, the in-port first.
        self.refs = edge_refs(edge)
        self.traffic: Optional[PortRate] = None
        self.verdict: Optional[PortVerdict] = None
        self.is_dead = False
        self.shows_name = False
        self._font = QFont(font)
        self._font.setPointSizeF(font.pointSizeF() * RATE_SCALE)
        self._metrics = QFontMetricsF(self._font)
        self.path = QPainterPath()
        self.label_area = QRectF()
        #: Control points of the curve.
        self.curve: Sequence[Point] = ()
        self._ends: object = None
        self._head = QPolygonF()
        self.setFlag(QGraphicsItem.ItemIsSelectable)
        self.setAcceptHoverEvents(True)

    def set_curve(self, curve: Sequence[Point], start: QPointF, end: QPointF) -> None:
        """Draw it along a curve, with the ends moved to the ports."""
        if self._ends == (curve, start, end):
            return
        self._ends = curve, start, end
        self.label_area = QRectF()  # until its label is placed there
        points = [QPointF(*point) for point in curve]
        at_start, at_end = start - points[0], end - points[-1]
        points[0] += at_start
        points[1] += at_start
        points[-1] += at_end
        points[-2] += at_end
        self.curve = [Point(point.x(), point.y()) for point in points]
        direction = points[-1] - points[-2]
        length = math.hypot(direction.x(), direction.y()) or 1.0
        path = QPainterPath(points[0])
        for first, second, third in zip(points[1::3], points[2::3], points[3::3]):
            path.cubicTo(first, second, third)
        self.path = path
        self._head = self._head_at(points[-1], direction / length)
        self._measure()

    def show(
        self, traffic: Optional[PortRate], verdict: Optional[PortVerdict], is_dead: bool
    ) -> bool:
        """Show its traffic and the last verdict; nothing comes along one that is dead.

        Returns whether its label needs another size.
        """
        looks = (None if is_dead else traffic, verdict, is_dead)
        if looks == (self.traffic, self.verdict, self.is_dead):
            return False
        stroke, shape = self.plain_stroke(), self.label_shape
        self.traffic, self.verdict, self.is_dead = looks
        if self.plain_stroke() == stroke:
            self.update(self.label_area)
        else:
            self.look_again()
        return self.label_shape != shape

    def place_label(self, area: Optional[Rectangle]) -> None:
        """Set the area of its label; None if there is no room for it."""
        found = QRectF() if area is None else rectangle_of(area)
        if found != self.label_area:
            self.label_area = found
            self._measure()

    @property
    def label_shape(self) -> str:
        """Its label without the numbers, which determines its width."""
        name = [self.edge.topic] if self.shows_name else []
        rate = "00.0 Hz" if self.traffic is None else _NUMBER.sub("00.0", self.traffic.text)
        return "\n".join([*name, rate, *(["FALSE"] if self.verdict is not None else [])])

    @property
    def label_size(self) -> Size:
        lines = self.label_shape.split("\n")
        width = max(self._metrics.horizontalAdvance(line) for line in lines)
        return Size(width, self._metrics.height() * len(lines))

    @property
    def is_dropping(self) -> bool:
        return self.traffic is not None and self.traffic.drop_rate > 0

    @property
    def label(self) -> str:
        parts = [self.edge.topic] if self.shows_name else []
        if self.traffic is not None:
            parts.append(self.traffic.text)
        if self.verdict is not None and self.verdict.truth is not Truth.UNKNOWN:
            parts.append(self.verdict.truth.name)
        return "\n".join(parts)

    def outline(self) -> QPainterPath:
        """Its line, in the coordinates of the drawing."""
        return self.path

    def shape(self) -> QPainterPath:
        """The area in which the pointer hits it: wider than the line."""
        stroker = QPainterPathStroker()
        stroker.setWidth(10)
        return stroker.createStroke(self.path)

    @qt_slot
    def paint(self, painter: QPainter, option: Any, widget: Any = None) -> None:
        self.paint_mark(painter, self.path)
        stroke = self.stroke()
        painter.setPen(stroke)
        painter.setBrush(Qt.NoBrush)
        painter.drawPath(self.path)
        painter.setBrush(QBrush(stroke.color()))
        painter.setPen(Qt.NoPen)
        painter.drawPolygon(self._head)
        if not self.label_area.isEmpty() and painter.worldTransform().m11() > _LEAST:
            painter.setFont(self._font)
            painter.setPen(self.colours.alarm if self.is_dropping else self.colours.muted)
            painter.drawText(self.label_area, Qt.AlignCenter, self.label)

    def stroke(self) -> QPen:
        if self.isSelected():
            return QPen(self.colours.chosen, 3.0)
        if self.tone is not Tone.NONE:
            return QPen(self.colours.of(self.tone), 2.0)
        if self.mark is not None and self.is_far:
            return QPen(self.mark_colour, 2.5)
        return self.plain_stroke()

    def plain_stroke(self) -> QPen:
        """The pen while nothing is selected or highlighted."""
        if self.is_dead:
            return QPen(self.colours.box_line, 1.1, Qt.DashLine)
        if self.verdict is not None:
            truth = self.verdict.truth
            return QPen(self.colours.of_truth(truth), 2.0, _DASHES[truth])
        return QPen(self.colours.alarm, 1.6) if self.is_dropping else QPen(self.colours.line, 1.1)

    @qt_slot
    def hoverEnterEvent(self, event: Any) -> None:  # noqa: N802
        self.scene().highlight(self.edge)

    @qt_slot
    def hoverLeaveEvent(self, event: Any) -> None:  # noqa: N802
        self.scene().highlight(None)

    def _head_at(self, tip: QPointF, along: QPointF) -> QPolygonF:
        across = QPointF(-along.y(), along.x())
        tip = tip - along * PORT_RADIUS if self.edge.head_port else tip
        back = tip - along * _ARROW
        return QPolygonF([tip, back + across * _ARROW * 0.4, back - across * _ARROW * 0.4])

    def _measure(self) -> None:
        area = self.path.boundingRect().adjusted(-_ARROW, -_ARROW, _ARROW, _ARROW)
        self.setRect(area.united(self.label_area))
