# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A connection while a hand draws it: a line to the pointer, with words beside that."""

from __future__ import annotations

from typing import TYPE_CHECKING

from python_qt_binding.QtCore import QPoint, QPointF, Qt
from python_qt_binding.QtGui import QPainterPath, QPalette, QPen
from python_qt_binding.QtWidgets import QGraphicsPathItem, QLabel

from dyknow.model.transformation import OUT
from dyknow_rqt.canvas.items import PortItem

if TYPE_CHECKING:
    from dyknow_rqt.canvas.view import GraphView

#: How far the line leads straight on from its ends, in pixels of the drawing.
_REACH = 50.0


class Wire(QLabel):
    """The words, hidden while no connection is drawn; ``start`` is None then."""

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
