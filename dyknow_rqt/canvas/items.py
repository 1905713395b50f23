# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The base class of the items, and the small ones: boxes, ports, and a wire that a hand draws."""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Any

from python_qt_binding.QtCore import QPoint, QPointF, QRectF, Qt
from python_qt_binding.QtGui import (
    QColor,
    QFont,
    QFontMetricsF,
    QPainter,
    QPainterPath,
    QPalette,
    QPen,
)
from python_qt_binding.QtWidgets import QGraphicsItem, QGraphicsPathItem, QGraphicsRectItem, QLabel

from dyknow.formulas import Truth
from dyknow.model.graph import PortRef
from dyknow.model.transformation import IN, OUT
from dyknow_rqt.canvas.appearance import LEAST_TEXT, ROOM, Colours, Tone, height_of
from dyknow_rqt.graph.figure import Edge
from dyknow_rqt.graph.geometry import Rectangle
from dyknow_rqt.graph.measurements import PortVerdict

if TYPE_CHECKING:
    from dyknow_rqt.canvas.view import GraphView

PORT_RADIUS = 4.0
#: Pixels: a smaller dot tells nothing beside the arrow that ends in it.
_LEAST_DOT = 1.5
#: Opacity of the halo around a marked item, of 255.
_HALO = 150


class Mark(enum.Enum):
    """The change of an item since the last graph."""

    CAME = "came"
    WENT = "went"
    MOVED = "moved"


def write(painter: QPainter, area: QRectF, text: str, larger: float) -> None:
    """Write a text around the middle of an area, larger by a factor."""
    painter.save()
    painter.translate(area.center())
    painter.scale(larger, larger)
    painter.drawText(QRectF(), Qt.AlignCenter | Qt.TextDontClip, text)
    painter.restore()


def rectangle_of(area: Rectangle) -> QRectF:
    return QRectF(area.left, area.top, area.right - area.left, area.bottom - area.top)


class Item(QGraphicsRectItem):
    """The base of all items: colours, a tone, a mark, and what is highlighted under the pointer.

    It paints within its rectangle: Qt asks for that so often that Python must not answer.
    """

    key: str | Edge = ""

    def __init__(self, colours: Colours, parent: QGraphicsItem | None = None) -> None:
        super().__init__(parent)
        self.setPen(QPen(Qt.NoPen))  # else the rectangle is larger by its width
        self.colours = colours
        self.tone = Tone.NONE
        self.mark: Mark | None = None

    def change(self, **looks: object) -> None:
        """Set attributes on which its look depends, and have it painted again if they differ."""
        for name, value in looks.items():
            if value != getattr(self, name):
                setattr(self, name, value)
                self.update()

    def hoverEnterEvent(self, event: Any) -> None:  # noqa: N802
        self.scene().highlight(self.key)

    def hoverLeaveEvent(self, event: Any) -> None:  # noqa: N802
        self.scene().highlight(None)

    @property
    def mark_colour(self) -> QColor:
        if self.mark is Mark.WENT:
            return self.colours.alarm
        return self.colours.true if self.mark is Mark.CAME else self.colours.both

    def paint_mark(self, painter: QPainter, outline: QPainterPath) -> None:
        """Paint a halo around an outline."""
        if self.mark is not None:
            colour = QColor(self.mark_colour)
            colour.setAlpha(_HALO)
            painter.setBrush(Qt.NoBrush)
            painter.setPen(QPen(colour, 9.0))
            painter.drawPath(outline)

    def set_colours(self, colours: Colours) -> None:
        self.colours = colours
        self.look_again()

    @property
    def is_far(self) -> bool:
        """Whether it is so small that the overview paints it."""
        return bool(self.flags() & QGraphicsItem.ItemHasNoContents)

    def set_far(self, is_far: bool) -> None:
        """Leave the painting to the overview, or take it back; the pointer still hits it."""
        self.setFlag(QGraphicsItem.ItemHasNoContents, is_far)

    def look_again(self) -> None:
        """Have it painted again: it looks different now."""
        self.update()
        if self.scene() is not None:
            self.scene().look_again()

    @property
    def stands_out(self) -> bool:
        """Whether it is marked, for now, so that the overview paints it on top."""
        return self.tone is not Tone.NONE or self.mark is not None or self.isSelected()


class BoxItem(Item):
    """The box of a namespace; its title is painted by the overview."""

    def __init__(self, group: tuple[str, ...], colours: Colours, font: QFont) -> None:
        super().__init__(colours)
        self.group = group
        self.name = group[-1]
        self._font = font
        self.area = QRectF()
        self.setZValue(-10 + len(group))

    def set_area(self, area: Rectangle) -> None:
        self.area = rectangle_of(area)
        self.setRect(self.area.adjusted(-2, -2, 2, 2))

    @property
    def title_area(self) -> QRectF:
        metrics = QFontMetricsF(self._font)
        corner = self.area.topLeft() + QPointF(8, 3)
        return QRectF(corner, metrics.size(Qt.TextSingleLine, self.name))

    def paint(self, painter: QPainter, option: Any, widget: Any = None) -> None:
        painter.setPen(QPen(self.colours.box_line, 1))
        painter.setBrush(self.colours.box)
        painter.drawRect(self.area)


class PortItem(Item):
    """A port: a dot on the left (in) or on the right (out) of its nodelet."""

    def __init__(self, ref: PortRef, direction: str, font: QFont, parent: Item) -> None:
        super().__init__(parent.colours, parent)
        self.ref = ref
        self.direction = direction
        self._font = font
        self.is_connected = False
        self.verdict: PortVerdict | None = None
        self.offered: bool | None = None
        self.setCursor(Qt.CrossCursor)
        self.setAcceptHoverEvents(True)
        self._hovered = False
        area = self.shape().boundingRect()
        for is_downwards in (False, True):
            for place in self._name_places(ROOM, is_downwards):
                area = area.united(place)
        self.setRect(area)

    @property
    def truth(self) -> Truth:
        return Truth.UNKNOWN if self.verdict is None else self.verdict.truth

    def set_offered(self, offered: bool | None) -> None:
        """Show whether the connection that is drawn could end here; None if none is drawn."""
        self.offered = offered
        self.setOpacity(0.3 if offered is False else 1.0)
        self.update()

    def shape(self) -> QPainterPath:
        """The area in which the pointer hits it: larger than the dot."""
        path = QPainterPath()
        path.addEllipse(QPointF(0, 0), PORT_RADIUS + 4, PORT_RADIUS + 4)
        return path

    def paint(self, painter: QPainter, option: Any, widget: Any = None) -> None:
        """Draw a dot, filled when connected; a square for a formula that does not hold."""
        large = self._hovered or bool(self.offered)
        is_plain = not large and self.truth is not Truth.FALSE
        if is_plain and PORT_RADIUS * painter.worldTransform().m11() < _LEAST_DOT:
            return
        radius = PORT_RADIUS + (2 if large else 0)
        colour = self.colours.chosen if large else self.colours.of_truth(self.truth)
        painter.setPen(QPen(colour, 1.2))
        painter.setBrush(colour if self.is_connected or large else self.colours.paper)
        if self.truth is Truth.FALSE:
            painter.drawRect(QRectF(-radius, -radius, 2 * radius, 2 * radius))
        else:
            painter.drawEllipse(QPointF(0, 0), radius, radius)
        if large:
            least = LEAST_TEXT / (height_of(self._font) * painter.worldTransform().m11())
            larger = max(1.0, min(least, ROOM))
            scene = self.scene()
            places = self._name_places(larger, scene.figure.is_downwards)
            free = (each for each in places if scene.is_free(self.mapRectToScene(each)))
            area = next(free, places[0])
            painter.fillRect(area, self.colours.paper)
            painter.setFont(self._font)
            painter.setPen(self.colours.text)
            write(painter, area, self.ref.port, larger)

    def _name_places(self, larger: float, is_downwards: bool) -> tuple[QRectF, QRectF]:
        """Return the areas on both sides of its arrow where its name may stand."""
        metrics = QFontMetricsF(self._font)
        width = (metrics.horizontalAdvance(self.ref.port) + 2) * larger
        height = metrics.height() * larger
        left, above = -width - 8, -height - 3
        if is_downwards:
            top = above if self.direction == IN else 3.0
            return QRectF(8.0, top, width, height), QRectF(left, top, width, height)
        side = left if self.direction == IN else 8.0
        return QRectF(side, 3.0, width, height), QRectF(side, above, width, height)

    def hoverEnterEvent(self, event: Any) -> None:  # noqa: N802
        self.change(_hovered=True)

    def hoverLeaveEvent(self, event: Any) -> None:  # noqa: N802
        self.change(_hovered=False)


#: How far the line leads straight on from its ends, in pixels of the drawing.
_REACH = 50.0


class Wire(QLabel):
    """The words beside a connection that a hand draws; hidden, with no start, while none is."""

    def __init__(self, view: GraphView) -> None:
        super().__init__(view.viewport())
        self._view = view
        self.start: PortItem | None = None
        self._line = QGraphicsPathItem()
        self.setAttribute(Qt.WA_TransparentForMouseEvents)
        self.setForegroundRole(QPalette.ToolTipText)
        self.setBackgroundRole(QPalette.ToolTipBase)
        self.setAutoFillBackground(True)
        self.setMargin(4)
        self.hide()

    def begin(self, start: PortItem) -> None:
        self.end()
        self.start, self._line = start, QGraphicsPathItem()
        self._line.setPen(QPen(start.colours.chosen, 2, Qt.DashLine))
        self._line.setZValue(20)
        self._view.scene().addItem(self._line)

    def lead(self, start: PortItem, end: QPointF) -> None:
        """Lead the line to a place of the drawing."""
        reach = _REACH if start.direction == OUT else -_REACH
        is_downwards = self._view.scene().figure.is_downwards
        way = QPointF(0, reach) if is_downwards else QPointF(reach, 0)
        path = QPainterPath(start.scenePos())
        path.cubicTo(start.scenePos() + way, end - way, end)
        self._line.setPath(path)

    def end(self) -> None:
        if self.start is not None:
            self._view.scene().removeItem(self._line)
        self.start = None
        self.hide()

    def say(self, text: str) -> None:
        """Say something beside the pointer."""
        self.setText(text)
        self.setWordWrap(False)
        width = min(self.sizeHint().width(), self._view.viewport().width())
        self.setWordWrap(True)
        self.resize(width, self.heightForWidth(width))
        self.show()

    def stay_beside(self, place: QPoint) -> None:
        """Keep the words in the view, beside a place of it."""
        room = self._view.viewport().size()
        left = max(0, min(place.x() + 18, room.width() - self.width()))
        below = place.y() + 24
        is_room = below + self.height() <= room.height()
        self.move(left, below if is_room else place.y() - 12 - self.height())
