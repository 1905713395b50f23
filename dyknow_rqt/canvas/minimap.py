# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The whole drawing in a corner of the view, with the part that is seen."""

from __future__ import annotations

from typing import Any, Callable, Iterator, Tuple

from python_qt_binding.QtCore import (
    QPoint,
    QPointF,
    QRect,
    QRectF,
    QSize,
    QSizeF,
    Qt,
    QTimer,
    Signal,
)
from python_qt_binding.QtGui import QPainter, QPen
from python_qt_binding.QtWidgets import QWidget

from dyknow_rqt.background_calls import qt_slot
from dyknow_rqt.canvas.overview import Overview
from dyknow_rqt.canvas.scene import GraphScene

#: Pixels: its largest size, and its distance from the edges of the view.
_LARGEST, _MARGIN = QSizeF(180, 130), 8
#: Milliseconds that the drawing may have changed before it shows.
_LAG = 300


class Minimap(QWidget):
    """Hidden while everything is seen; a press or a drag moves the view."""

    #: The place of the drawing that is to be in the middle.
    place_wanted = Signal(QPointF)

    def __init__(self, scene: GraphScene, report: Callable[[str], None], view: QWidget) -> None:
        super().__init__(view)
        self.report = report
        self._scene = scene
        self._seen = QRectF()
        self._overview = Overview()
        self._lag = QTimer(self, singleShot=True, interval=_LAG)
        self._lag.timeout.connect(self._look)
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
            size = whole.size().scaled(_LARGEST, Qt.KeepAspectRatio).toSize()
            size = size.expandedTo(QSize(24, 24))
            corner = self.parentWidget().rect().bottomRight() - QPoint(_MARGIN, _MARGIN)
            self.setGeometry(QRect(corner - QPoint(size.width(), size.height()), size))
        if is_useful and (not self.isVisible() or self._overview.area != whole):
            self._lag.start(0)
        self.setVisible(is_useful)
        self.update()

    @qt_slot
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

    @qt_slot
    def mousePressEvent(self, event: Any) -> None:  # noqa: N802
        corner, scale = self._frame()
        self.place_wanted.emit(QPointF(event.pos()) / scale + corner)

    @qt_slot
    def mouseMoveEvent(self, event: Any) -> None:  # noqa: N802
        self.mousePressEvent(event)

    @qt_slot
    def _look(self) -> None:
        if self.isVisible():
            self._scene.slices.want(self._picture)

    def _picture(self) -> Iterator[None]:
        area = self._scene.drawing_area()
        if not area.isEmpty():
            scale = self._frame()[1] * self.devicePixelRatioF()
            yield from self._scene.overview_of(self._overview, area, scale)
            self.update()

    def _frame(self) -> Tuple[QPointF, float]:
        """The corner of the shown area, and its scale."""
        whole = self._scene.drawing_area()
        scale = min(self.width() / whole.width(), self.height() / whole.height())
        room = QPointF(self.width() / scale, self.height() / scale)
        return whole.center() - room / 2, scale
