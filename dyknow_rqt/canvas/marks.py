# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Marks what came, went, moved or was mended, for some seconds."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

from python_qt_binding.QtCore import QObject, QPointF, Qt, QTimer
from python_qt_binding.QtGui import QPainterPath, QPen
from python_qt_binding.QtWidgets import QGraphicsItem, QGraphicsPathItem, QGraphicsSimpleTextItem

from dyknow_rqt.canvas.arrows import EdgeItem
from dyknow_rqt.canvas.items import Mark
from dyknow_rqt.canvas.vertices import VertexItem
from dyknow_rqt.graph.figure import VertexKind, key_of
from dyknow_rqt.graph.snapshot import Difference

if TYPE_CHECKING:
    from dyknow_rqt.canvas.scene import GraphScene

#: Seconds until marks go.
_LASTING = 8.0
_FAINT = 0.35


class Marks(QObject):
    """The marks of a scene, also of things that are drawn after the difference is known.

    A nodelet that went is drawn faintly where it was, unless another is there now, and linked with
    the one that replaces it.
    """

    def __init__(self, scene: GraphScene) -> None:
        super().__init__(scene)
        self._scene = scene
        #: The ends of differences, with what they mark.
        self._noted: list[tuple[float, Difference]] = []
        self._shown = Difference()
        self.ghosts: dict[str, VertexItem] = {}
        self.links: list[QGraphicsItem] = []
        self._ending = QTimer(self, singleShot=True, timeout=self._follow)

    def show(self, found: Difference, is_lasting: bool = False) -> None:
        """Mark a difference besides the marked ones; ``is_lasting`` until all are cleared."""
        end = math.inf if is_lasting else time.monotonic() + _LASTING
        self._noted.append((end, found))
        self._follow()

    def clear(self) -> None:
        self._noted = []
        self._follow()

    def _follow(self) -> None:
        """Mark the differences that have not ended."""
        now, shown = time.monotonic(), Difference()
        self._noted = [each for each in self._noted if each[0] > now]
        for _, found in self._noted:
            shown = Difference(
                (shown.came | found.came) - found.went,
                (shown.went | found.went) - found.came,
                shown.moved | found.moved,
                (*shown.mended, *found.mended),
            )
        self._shown = shown
        next_end = min((end for end, _ in self._noted), default=math.inf)
        if next_end < math.inf:
            self._ending.start(math.ceil((next_end - now) * 1000))
        self.apply()

    def of(self, item: EdgeItem | VertexItem) -> Mark | None:
        shown = self._shown
        if isinstance(item, EdgeItem):
            return Mark.MOVED if any(ref in shown.moved for ref in item.refs) else None
        if item.vertex.kind is not VertexKind.NODELET:
            return None
        name = item.vertex.name
        return Mark.CAME if name in shown.came else Mark.WENT if name in shown.went else None

    def keep(self, item: VertexItem) -> bool:
        """Keep an item that is drawn no more as a ghost, if its nodelet went."""
        if self.of(item) is not Mark.WENT:
            return False
        item.setOpacity(_FAINT)
        item.setEnabled(False)
        item.setSelected(False)
        item.setZValue(5)
        self.ghosts[item.vertex.name] = item
        return True

    def apply(self) -> None:
        """Mark the items that are drawn now, and link nodelets with their replacements."""
        scene, shown = self._scene, self._shown
        for item in (*scene.things.values(), *self.ghosts.values()):
            item.change(mark=self.of(item))
        for name in [name for name in self.ghosts if name not in shown.went]:
            scene.removeItem(self.ghosts.pop(name))
        for ghost in self.ghosts.values():
            over = (each for each in ghost.collidingItems() if isinstance(each, VertexItem))
            ghost.setVisible(not any(each.isEnabled() for each in over))
        for link in self.links:
            scene.removeItem(link)
        self.links = []
        for before, after in shown.mended:
            ends = [
                self.ghosts.get(name) or scene.vertices.get(key_of(VertexKind.NODELET, name))
                for name in (before, after)
            ]
            if ends[0] is not None and ends[1] is not None:
                self._link(ends[0], ends[1])
        scene.mark()

    def _link(self, before: VertexItem, after: VertexItem) -> None:
        """Write "mended" over a line between the two, or beside the second where both are."""
        start, end = before.pos(), after.pos()
        colour, path = self._scene.colours.true, QPainterPath(start)
        middle = (start + end) / 2 - QPointF(0, 40)
        path.quadTo(middle, end)
        line = QGraphicsPathItem(path)
        line.setPen(QPen(colour, 2.0, Qt.DashLine))
        text = QGraphicsSimpleTextItem("mended")
        text.setBrush(colour)
        text.setPos(path.pointAtPercent(0.5) - QPointF(text.boundingRect().width() / 2, 18))
        if before.collidesWithItem(after):
            line.hide()
            text.setPos(after.sceneBoundingRect().topRight())
        for item in (line, text):
            item.setZValue(15)
            item.setEnabled(False)
            self._scene.addItem(item)
            self.links.append(item)
