# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The drawing in a few strokes, where it is too small for names, and the titles of its boxes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Dict, Iterable, List, NamedTuple, Optional, Tuple

from python_qt_binding.QtCore import QPointF, QRectF, Qt
from python_qt_binding.QtGui import (
    QBrush,
    QColor,
    QFont,
    QFontMetricsF,
    QPainter,
    QPainterPath,
    QPen,
)

if TYPE_CHECKING:
    from dyknow_rqt.canvas.appearance import Colours
    from dyknow_rqt.canvas.arrows import EdgeItem
    from dyknow_rqt.canvas.items import BoxItem
    from dyknow_rqt.canvas.vertices import VertexItem

#: Pixels of the screen per pixel of the drawing: with less names cannot be read, and the overview
#: paints everything.
FAR = 0.3
#: Below this zoom ovals are dots; smooth ones would take longer than all the rest.
_DOTS = 0.2
#: Least size of a title beside names that can be read, as a part of its full one.
_SMALL = 0.75
#: Pixels of the screen: the least width that a title is cut to, and its margin.
_NARROW, _MARGIN = 90.0, 3.0


#: Pixels from where on an arrow is light, so as not to hide what it passes.
_LONG = 600.0


class _Stroke(NamedTuple):
    """Shapes that are painted with one pen and one brush."""

    pen: QPen
    brush: QBrush
    path: QPainterPath


class Overview:
    """Paints all vertices and arrows of one look together, as Qt does fast.

    Painting one by one calls Python thousands of times for a picture of 500 nodelets.
    """

    def __init__(self) -> None:
        self._strokes: Optional[List[_Stroke]] = None

    def forget(self) -> None:
        """Gather the strokes again: something looks different now."""
        self._strokes = None

    def paint(
        self,
        painter: QPainter,
        boxes: Iterable[BoxItem],
        edges: Iterable[EdgeItem],
        vertices: Iterable[VertexItem],
    ) -> None:
        """Paint boxes, arrows, then vertices; in the coordinates of the drawing."""
        for box in boxes:
            box.paint(painter, None)
        if self._strokes is None:
            self._strokes = [*_arrows(edges), *_shapes(vertices)]
        is_smooth = painter.worldTransform().m11() > _DOTS
        for pen, brush, path in self._strokes:
            is_line = brush.style() == Qt.NoBrush
            painter.setRenderHint(QPainter.Antialiasing, is_line or is_smooth)
            painter.setPen(pen)
            painter.setBrush(brush)
            painter.drawPath(path)


def paint_titles(
    painter: QPainter,
    titles: Iterable[Tuple[QRectF, str]],
    font: QFont,
    colours: Colours,
    seen: QRectF,
) -> None:
    """Write titles so large that they can be read; of two that meet only the first.

    Beside names that can be read they shrink with these, so as to cover none of them.

    Args:
        painter: in the coordinates of the drawing.
        titles: their owners and their texts.
        font: at full size.
        colours: of the drawing.
        seen: the part of the drawing that is in view; a title stays in it with its owner.
    """
    zoom = min(1.0, painter.worldTransform().m11())
    is_far = zoom * painter.device().devicePixelRatioF() < FAR
    pixel = (1.0 if is_far else max(_SMALL, zoom)) / zoom
    metrics = QFontMetricsF(font)
    taken: List[QRectF] = []
    ground = QColor(colours.box)
    ground.setAlpha(210)
    painter.setFont(font)
    for whole, title in titles:
        owner = whole & seen
        if owner.isEmpty() or (owner != whole and owner.width() < _NARROW * pixel):
            continue  # what is left of it would hide the title of the next one
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


def _arrows(edges: Iterable[EdgeItem]) -> Iterable[_Stroke]:
    found: Dict[Tuple[float, int, int], _Stroke] = {}
    for edge in edges:
        pen, area = edge.stroke(), edge.rect()
        if max(area.width(), area.height()) > _LONG and pen.color() == edge.colours.line:
            pen.setColor(edge.colours.box_line)
        stroke = found.setdefault(_look(pen), _Stroke(_thin(pen), QBrush(), QPainterPath()))
        stroke.path.addPath(edge.path)
    return [stroke for _, stroke in sorted(found.items())]


def _shapes(vertices: Iterable[VertexItem]) -> Iterable[_Stroke]:
    found: Dict[Tuple[object, ...], _Stroke] = {}
    for item in vertices:
        pen, fill = item.stroke(), item.fill()
        look = (*_look(pen), fill.rgba())
        stroke = found.setdefault(look, _Stroke(_thin(pen), QBrush(fill), QPainterPath()))
        area = item.area.translated(item.pos())
        if item.vertex.kind.is_square:
            stroke.path.addRect(area)
        else:
            stroke.path.addEllipse(area)
    return [stroke for _, stroke in sorted(found.items())]


def _look(pen: QPen) -> Tuple[float, int, int]:
    """The attributes that pens of one look share; those that stand out come last."""
    return pen.widthF(), pen.color().rgba(), int(pen.style())


def _thin(pen: QPen) -> QPen:
    """The pen as wide on the screen as it is in the drawing at full size."""
    pen.setCosmetic(True)
    return pen
