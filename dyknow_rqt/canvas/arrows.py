# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Arrows, their rates, and the places of these."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, Callable, Mapping, Match, Sequence

from python_qt_binding.QtCore import QObject, QPointF, QRectF, Qt, QTimer
from python_qt_binding.QtGui import (
    QColor,
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
from dyknow_rqt.background_calls import BackgroundCalls
from dyknow_rqt.canvas.appearance import LEAST_TEXT, NUMBER, ROOM, Colours, Tone, height_of
from dyknow_rqt.canvas.items import PORT_RADIUS, Item, rectangle_of, write
from dyknow_rqt.graph.figure import Edge, VertexKind, edge_refs, key_of
from dyknow_rqt.graph.geometry import Point, Rectangle, Size, place_labels
from dyknow_rqt.graph.measurements import PortRate, PortVerdict

if TYPE_CHECKING:
    from dyknow_rqt.canvas.scene import GraphScene

#: Pixels: the length of a head, and the width of a line.
_ARROW, _THIN = 8.0, 1.1
_DASHES = {Truth.TRUE: Qt.SolidLine, Truth.FALSE: Qt.DashLine, Truth.UNKNOWN: Qt.DotLine}
_TOPIC, _GHOST = key_of(VertexKind.TOPIC, ""), key_of(VertexKind.GHOST, "")
_NUMBER = re.compile(r"[\d.]+")
#: A size of letters between the largest and the plain one; and by how much 0.25 is wider at most
#: than a usual number.
_BETWEEN, _SPARE = 1.2, 1.1
#: Bytes a second from which on an arrow is wider; pixels for each factor of ten, and at most.
_BROAD, _WIDER, _WIDEST = 1e6, 1.5, 5.0


class EdgeItem(Item):
    """An arrow with its rate, and the last verdict that came along it."""

    def __init__(self, edge: Edge, colours: Colours, font: QFont) -> None:
        super().__init__(colours)
        self.key = self.edge = edge
        #: The ports at its ends, the in-port first.
        self.refs = edge_refs(edge)
        self.traffic: PortRate | None = None
        self.verdict: PortVerdict | None = None
        self.is_dead = False
        ends = (edge.tail, edge.head)
        #: Whether it is part of a plan; then it has a port in place of a topic, and is only seen.
        self.is_planned = any(key.startswith(_GHOST) for key in ends)
        self.setEnabled(not self.is_planned)
        #: Whether its label has the topic: it leads past the rectangle of that.
        self.shows_name = not any(key.startswith(_TOPIC) for key in ends)
        self._font, self._height = font, height_of(font)
        self._metrics = QFontMetricsF(font)
        self.path = QPainterPath()
        self.label_area = QRectF()
        #: Control points of the curve.
        self.curve: Sequence[Point] = ()
        self._ends: object = None
        self._tip = self._along = QPointF()
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
        self._tip, self._along = points[-1], direction / length
        self._measure()

    def show(self, traffic: PortRate | None, verdict: PortVerdict | None, is_dead: bool) -> bool:
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

    def place_label(self, area: Rectangle | None) -> None:
        """Set the area of its label; None if it has no room."""
        found = QRectF() if area is None else rectangle_of(area)
        if found != self.label_area:
            self.label_area = found
            self._measure()

    @property
    def label_shape(self) -> str:
        """Its label without the numbers, which determines its width."""
        name = [self.edge.topic] if self.shows_name else []
        text = "0 Hz" if self.traffic is None else self.traffic.text
        rate = _NUMBER.sub(_usual, text)
        return "\n".join([*name, rate, *(["FALSE"] if self.verdict is not None else [])])

    @property
    def label_sizes(self) -> tuple[Size, ...]:
        """The sizes that its label may have, the largest first."""
        shape, height = self.label_shape, self._metrics.height()
        width, breaks = self._width_of(shape), shape.count("\n")
        scales = (ROOM, _BETWEEN, 1.0, min(1.0, _SPARE * LEAST_TEXT / self._height))
        lines = [scale * breaks + min(scale, 1.0) for scale in scales]  # a line has some room
        return tuple(Size(scale * width, n * height) for scale, n in zip(scales, lines))

    @property
    def label_scale(self) -> float:
        """The largest size of the letters for which there is room, by their plain size."""
        if not self.label or self.label_area.isEmpty():
            return 0.0
        scale = min(ROOM, self.label_area.width() / self._width_of(self.label))
        breaks = self.label_shape.count("\n")
        if breaks:
            lines = self.label_area.height() / self._metrics.height()
            scale = min(scale, max((lines - 1) / breaks, lines / (breaks + 1)))
        return float(scale)

    def _width_of(self, text: str) -> float:
        return float(max(self._metrics.horizontalAdvance(line) for line in text.split("\n")))

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

    def paint(self, painter: QPainter, option: Any, widget: Any = None) -> None:
        self.paint_mark(painter, self.path)
        stroke = self.stroke()
        painter.setPen(stroke)
        painter.setBrush(Qt.NoBrush)
        painter.drawPath(self.path)
        painter.setBrush(stroke.color())
        painter.setPen(Qt.NoPen)
        painter.drawPolygon(self._head(_ARROW + 2 * (self.breadth - _THIN)))
        least = LEAST_TEXT / (self._height * painter.worldTransform().m11())
        most = self.label_scale if least <= ROOM else 0.0
        if least <= most:
            painter.setFont(self._font)
            painter.setPen(self.colours.alarm if self.is_dropping else self.colours.muted)
            write(painter, self.label_area, self.label, max(least, min(most, 1.0)))

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
            return QPen(self.colours.box_line, _THIN, Qt.DashLine)
        if self.verdict is not None:
            truth = self.verdict.truth
            return QPen(self.colours.of_truth(truth), 2.0, _DASHES[truth])
        colour = self._complaint
        width = max(self.breadth, 1.6 if colour is not None else _THIN)
        return QPen(self.colours.line if colour is None else colour, width)

    @property
    def breadth(self) -> float:
        """The width of its line by its bandwidth, in steps of half a pixel."""
        bandwidth = self.traffic.bandwidth if self.traffic is not None else None
        if bandwidth is None or bandwidth <= _BROAD:
            return _THIN
        steps = round(2 * _WIDER * math.log10(bandwidth / _BROAD))
        return min(_THIN + steps / 2, _WIDEST)

    @property
    def _complaint(self) -> QColor | None:
        """The colour that says that messages are dropped, or else old; None for neither."""
        if self.is_dropping:
            return self.colours.alarm
        is_old = self.traffic is not None and self.traffic.is_old
        return self.colours.warning if is_old else None

    def _head(self, length: float) -> QPolygonF:
        along, across = self._along, QPointF(-self._along.y(), self._along.x())
        tip = self._tip - along * PORT_RADIUS if self.edge.head_port else self._tip
        back = tip - along * length
        return QPolygonF([tip, back + across * length * 0.4, back - across * length * 0.4])

    def _measure(self) -> None:
        area = self.path.boundingRect().adjusted(-_ARROW, -_ARROW, _ARROW, _ARROW)
        self.setRect(area.united(self.label_area))


def _usual(number: Match[str]) -> str:
    """The same for all numbers but those of four digits and more."""
    is_usual = "." in number[0] or len(number[0]) <= len(NUMBER)
    return NUMBER if is_usual else "0" * len(number[0])


class ArrowLabels(QObject):
    """Places labels where they cover nothing, once they are large enough to be read."""

    def __init__(self, scene: GraphScene) -> None:
        super().__init__(scene)
        self._scene = scene
        self._calls = BackgroundCalls(1)
        #: Whether some are to be placed again, when they can be read.
        self.are_wanted = False
        self._soon = QTimer(self, singleShot=True, interval=0, timeout=self._place)

    def close(self) -> None:
        self._soon.stop()
        self._calls.close()

    @property
    def are_placed(self) -> bool:
        """Whether all that can be read are where they belong."""
        return not (self._calls.is_calling or self._soon.isActive())

    def place(self) -> None:
        """Place all labels again, soon."""
        self._soon.start()

    def place_now(self) -> None:
        self._take(self._search()())

    def _place(self) -> None:
        self.are_wanted = self._scene.is_far
        if not self.are_wanted:
            self._calls.run_once("labels", self._search(), self._take, again=True)

    def _search(self) -> Callable[[], Mapping[Edge, Rectangle]]:
        """Return a function that finds places for the labels, in any thread."""
        edges, boxes = self._scene.edges, self._scene.boxes.values()
        areas = [area for item in self._scene.vertices.values() for area in item.inked]
        areas += [box.title_area for box in boxes]
        curves = {edge: item.curve for edge, item in edges.items()}
        sizes = {edge: item.label_sizes for edge, item in edges.items()}
        obstacles = [Rectangle(*area.getCoords()) for area in areas]
        obstacles += [side for box in boxes for side in Rectangle(*box.area.getCoords()).sides]
        return lambda: place_labels(curves, sizes, obstacles)

    def _take(self, places: Mapping[Edge, Rectangle]) -> None:
        for edge, item in self._scene.edges.items():
            item.place_label(places.get(edge))
        self._scene.measure()
