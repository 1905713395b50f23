# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The drawing in a few strokes, where it is too small for names, and as a map; titles of boxes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Iterable, Iterator, Tuple

from python_qt_binding.QtCore import QPoint, QPointF, QRect, QRectF, QSize, Qt, QTimer, Signal
from python_qt_binding.QtGui import (
    QColor,
    QFont,
    QFontMetricsF,
    QImage,
    QPainter,
    QPainterPath,
    QPen,
)
from python_qt_binding.QtWidgets import QWidget

from dyknow_rqt.canvas.appearance import Colours
from dyknow_rqt.canvas.arrows import EdgeItem
from dyknow_rqt.canvas.vertices import VertexItem

if TYPE_CHECKING:
    from dyknow_rqt.canvas.scene import GraphScene

#: Pixels of the screen per pixel of the drawing: with less names cannot be read, and the overview
#: paints everything.
FAR = 0.3
#: Below this zoom ovals are dots; smooth ones would take longer than all the rest.
_DOTS = 0.2
#: Least size of a title beside names that can be read, as a part of its full one, and its most
#: pixels of the drawing: more would cover the contents.
_SMALL, _TALLEST = 0.75, 23.0
#: Pixels of the screen: the least width that a title is cut to, and its margin.
_NARROW, _MARGIN = 90.0, 3.0


#: Pixels from where on an arrow is light, so as not to hide the items below it.
_LONG = 600.0
#: Pixels: the width of a line that stands for a ring.
_RING = 2.2
#: Pixels of a picture.
_MOST_PIXELS = 6e6


class Overview:
    """A picture of the boxes, arrows and vertices in an area of the drawing, without names.

    It is painted in steps; until it is done the last picture is shown. Its scale, in pixels per
    pixel of the drawing, is 0 before the first.
    """

    def __init__(self) -> None:
        self.area = QRectF()
        self.scale = 0.0
        self._picture = QImage()

    def painted(self, scene: GraphScene, area: QRectF, scale: float) -> Iterator[None]:
        """Paint another picture, a step at a time; of a large area a coarse one."""
        boxes = sorted(scene.boxes.values(), key=lambda box: box.zValue())
        edges, vertices = list(scene.edges.values()), list(scene.vertices.values())
        scale = min(scale, (_MOST_PIXELS / (area.width() * area.height())) ** 0.5)
        picture = QImage((area.size() * scale).toSize(), QImage.Format_RGB32)
        picture.fill(scene.colours.paper)
        painter = QPainter(picture)
        painter.scale(scale, scale)
        painter.translate(-area.topLeft())
        try:
            for box in boxes:
                box.paint(painter, None)
                yield
            for strokes in (_arrows(edges), _shapes(vertices)):
                found = []
                for stroke in strokes:
                    found.append(stroke)
                    yield
                for look, path in sorted(found, key=lambda stroke: stroke[0]):
                    _stroke(painter, look, path, scale)
                    yield
        finally:
            painter.end()
        self._picture, self.area, self.scale = picture, area, scale

    def paint(self, painter: QPainter) -> None:
        """Paint the last picture where it belongs, in the coordinates of the drawing."""
        painter.save()
        transform = painter.worldTransform()
        pixels = painter.device().devicePixelRatioF()
        if abs(transform.m11() * pixels - self.scale) < 1e-6:  # copied as it is, which is faster
            self._picture.setDevicePixelRatio(pixels)
            corner = transform.map(self.area.topLeft())
            painter.resetTransform()
            painter.drawImage(corner.toPoint(), self._picture)
        elif self.scale:
            self._picture.setDevicePixelRatio(1.0)
            painter.drawImage(self.area, self._picture)
        painter.restore()


def paint_marked(painter: QPainter, items: Iterable[EdgeItem | VertexItem]) -> None:
    """Paint the things that stand out on top of a picture, in the coordinates of the drawing."""
    painter.setRenderHint(QPainter.Antialiasing)
    painter.setBrush(Qt.NoBrush)
    for item in items:
        pen = item.stroke()
        pen.setCosmetic(True)
        painter.setPen(pen)
        painter.drawPath(item.outline())


def paint_titles(
    painter: QPainter,
    titles: Iterable[tuple[QRectF, str]],
    font: QFont,
    colours: Colours,
    seen: QRectF,
) -> None:
    """Write titles so large that they can be read, in their owners; of two that meet the first.

    Beside names that can be read they shrink with these, so as to cover none of them. A title
    stays in the part that is seen with its owner.
    """
    zoom = min(1.0, painter.worldTransform().m11())
    is_far = zoom * painter.device().devicePixelRatioF() < FAR
    metrics = QFontMetricsF(font)
    beside = min(max(_SMALL, zoom) / zoom, _TALLEST / metrics.height())
    pixel = 1.0 / zoom if is_far else beside
    taken: list[QRectF] = []
    ground = QColor(colours.box)
    ground.setAlpha(210)
    painter.setFont(font)
    for whole, title in titles:
        owner = whole & seen
        if owner.isEmpty() or (owner != whole and owner.width() < _NARROW * pixel):
            continue  # the rest of it would hide the title of the next one
        room = max(_NARROW, (owner.width() - 16) / pixel)
        text = metrics.elidedText(title, Qt.ElideMiddle, room)
        size = QRectF(0, 0, metrics.horizontalAdvance(text), metrics.height())
        size = size.adjusted(-_MARGIN, 0, _MARGIN, 0)
        corner = owner.topLeft() + QPointF(8, 3)
        area = QRectF(corner, size.size() * pixel)
        inner = area.adjusted(0, pixel, 0, -pixel)  # letters leave a little room
        if any(inner.intersects(other) for other in taken):
            continue
        taken.append(area)
        painter.save()
        painter.translate(corner)
        painter.scale(pixel, pixel)
        painter.fillRect(size, ground)
        painter.setPen(colours.muted)
        painter.drawText(size, Qt.AlignCenter, text)
        painter.restore()


#: Width, colours of pen and brush, and style of the pen; those that stand out come last.
_Look = Tuple[float, int, int, int]


def _stroke(painter: QPainter, look: _Look, path: QPainterPath, scale: float) -> None:
    width, colour, fill, style = look
    pen = QPen(QColor.fromRgba(colour), width, Qt.PenStyle(style))
    pen.setCosmetic(True)  # as wide as it is in the drawing at full size
    painter.setPen(pen)
    painter.setBrush(QColor.fromRgba(fill) if fill else Qt.NoBrush)
    painter.setRenderHint(QPainter.Antialiasing, not fill or scale > _DOTS)
    painter.drawPath(path)


def _arrows(edges: Iterable[EdgeItem]) -> Iterator[tuple[_Look, QPainterPath]]:
    for edge in edges:
        pen, area = edge.plain_stroke(), edge.rect()
        if max(area.width(), area.height()) > _LONG and pen.color() == edge.colours.line:
            pen.setColor(edge.colours.box_line)
        yield _look(pen), edge.path


def _shapes(vertices: Iterable[VertexItem]) -> Iterator[tuple[_Look, QPainterPath]]:
    for item in vertices:
        pen, share = item.ring
        pen.setWidthF(_RING)
        yield _look(pen if share else item.plain_stroke(), item.fill().rgba()), item.outline()


def _look(pen: QPen, fill: int = 0) -> _Look:
    return pen.widthF(), pen.color().rgba(), fill, int(pen.style())


#: Pixels: its largest size, and its distance from the edges of the view.
_LARGEST, _OFF_EDGE = (180, 130), 8
#: Milliseconds that the drawing may have changed before it shows.
_LAG = 300


class Minimap(QWidget):
    """Hidden while everything is seen; a press or a drag moves the view."""

    #: The place of the drawing that is to be in the middle.
    place_wanted = Signal(QPointF)

    def __init__(self, scene: GraphScene, view: QWidget) -> None:
        super().__init__(view)
        self._scene = scene
        self._seen = QRectF()
        self._overview = Overview()
        self._lag = QTimer(self, singleShot=True, interval=_LAG, timeout=self._look)
        self.setCursor(Qt.SizeAllCursor)
        self.setToolTip("The whole graph: press or drag to move there")
        self.setAccessibleName("Map of the graph")
        scene.changed_looks.connect(self._lag.start)
        scene.changed_marks.connect(self.update)
        self.hide()

    def follow(self, seen: QRectF) -> None:
        """Show which part of the drawing is seen; hide if that is all of it."""
        self._seen, whole = seen, self._scene.drawing_area()
        is_useful = not whole.isEmpty() and not seen.contains(whole)
        if is_useful:
            size = whole.size().scaled(*_LARGEST, Qt.KeepAspectRatio).toSize()
            size = size.expandedTo(QSize(24, 24))
            corner = self.parentWidget().rect().bottomRight() - QPoint(_OFF_EDGE, _OFF_EDGE)
            self.setGeometry(QRect(corner - QPoint(size.width(), size.height()), size))
        if is_useful and (not self.isVisible() or self._overview.area != whole):
            self._lag.start(0)
        self.setVisible(is_useful)
        self.update()

    def paintEvent(self, event: Any) -> None:  # noqa: N802
        painter = QPainter(self)
        corner, scale = self._frame()
        painter.fillRect(self.rect(), self._scene.backgroundBrush())
        painter.save()
        painter.scale(scale, scale)
        painter.translate(-corner)
        self._overview.paint(painter)
        self._scene.paint_marked(painter)
        painter.restore()
        seen = QRectF(
            (self._seen.topLeft() - corner) * scale, self._seen.size() * scale
        ).intersected(QRectF(self.rect()).adjusted(0, 0, -1, -1))
        painter.setPen(QPen(self.palette().highlight().color(), 2))
        painter.drawRect(seen)
        painter.setPen(self.palette().mid().color())
        painter.drawRect(self.rect().adjusted(0, 0, -1, -1))

    def mousePressEvent(self, event: Any) -> None:  # noqa: N802
        corner, scale = self._frame()
        self.place_wanted.emit(QPointF(event.pos()) / scale + corner)

    def mouseMoveEvent(self, event: Any) -> None:  # noqa: N802
        self.mousePressEvent(event)

    def _look(self) -> None:
        if self.isVisible():
            self._scene.slices.want(self._picture)

    def _picture(self) -> Iterator[None]:
        area = self._scene.drawing_area()
        if not area.isEmpty():
            scale = self._frame()[1] * self.devicePixelRatioF()
            yield from self._overview.painted(self._scene, area, scale)
            self.update()

    def _frame(self) -> tuple[QPointF, float]:
        """The corner of the shown area, and its scale."""
        whole = self._scene.drawing_area()
        scale = min(self.width() / whole.width(), self.height() / whole.height())
        room = QPointF(self.width() / scale, self.height() / scale)
        return whole.center() - room / 2, scale
