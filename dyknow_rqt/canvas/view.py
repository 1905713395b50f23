# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The view of the drawing: zoom, drags and keys."""

from __future__ import annotations

from typing import Any, Iterable, Union

from python_qt_binding.QtCore import QEvent, QPoint, QPointF, QRect, QRectF, Qt, Signal
from python_qt_binding.QtGui import QPainter, QTransform
from python_qt_binding.QtWidgets import QApplication, QFrame, QGraphicsView

from dyknow.model.graph import PortRef
from dyknow_rqt.canvas.arrows import EdgeItem
from dyknow_rqt.canvas.items import Item, PortItem, Wire
from dyknow_rqt.canvas.overview import Minimap
from dyknow_rqt.canvas.scene import GraphScene
from dyknow_rqt.canvas.vertices import VertexItem
from dyknow_rqt.graph.figure import Edge, VertexKind
from dyknow_rqt.graph.geometry import Point

#: Where a connection may end: at a port, at the topic of that name, or in an arrow.
Target = Union[None, str, PortRef, Edge]

_STEP = 1.2
#: The drawing is fitted again if it could be larger by this factor.
_ROOM = 1.5
_SMALLEST, _LARGEST = 0.05, 8.0
#: From the first zoom on names can be made out, from the second on they can be read well.
_LEGIBLE, _READABLE = 0.45, 0.7
#: Pixels that a key moves the view.
_WAY = 60.0
_ARROWS = {
    Qt.Key_Left: QPointF(-1, 0),
    Qt.Key_Right: QPointF(1, 0),
    Qt.Key_Up: QPointF(0, -1),
    Qt.Key_Down: QPointF(0, 1),
}


def topic_of(item: object) -> str:
    """The topic of an arrow or of a rectangle; empty for all else."""
    if isinstance(item, EdgeItem):
        return item.edge.topic
    if isinstance(item, VertexItem) and item.vertex.kind is VertexKind.TOPIC:
        return item.vertex.name
    return ""


class GraphView(QGraphicsView):
    """The wheel zooms at the pointer, a drag on the background moves, one from a port connects."""

    #: A connection was drawn from a port to a target, or to the ground; its place in the drawing.
    dropped = Signal(object, object, QPointF)
    #: Vertices were moved: their new centres by their keys.
    moved = Signal(object)
    #: A connection is being drawn from a port.
    drag_began = Signal(object)
    #: It is over another port now, the topic of that name, or None.
    dragged = Signal(object, object)
    #: An arrow or a topic was clicked: the topic; or the ground: an empty name.
    topic_pressed = Signal(str)
    #: A box was double-clicked: its group.
    box_pressed = Signal(object)
    #: The Delete key was pressed.
    delete_pressed = Signal()
    #: A context menu is wanted: the item, or None for the background, and the place on the screen.
    menu_wanted = Signal(object, QPoint)
    #: It has another size, which its viewport has too.
    resized = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.setScene(GraphScene(self.palette(), self.font(), self))
        self.setRenderHint(QPainter.Antialiasing)
        self.setFrameShape(QFrame.NoFrame)
        self.setDragMode(QGraphicsView.ScrollHandDrag)
        self.viewport().setCursor(Qt.ArrowCursor)
        self.setTransformationAnchor(QGraphicsView.AnchorUnderMouse)
        self.setResizeAnchor(QGraphicsView.NoAnchor)
        self.setViewportUpdateMode(QGraphicsView.SmartViewportUpdate)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarAlwaysOff)
        self.setVerticalScrollBarPolicy(Qt.ScrollBarAlwaysOff)
        self.setAccessibleName("Computation graph")
        #: Whether the user has zoomed or moved the view.
        self.is_chosen = False
        #: Whether hands may change the graph.
        self.is_editable = True
        self._target: Target = None
        self._ground: QPoint | None = None
        self._pressed = QPoint()
        #: The vertices that the pointer holds, with their places before they moved.
        self._starts: dict[str, QPointF] = {}
        self._is_moving = False
        self._minimap = Minimap(self.scene(), self)
        self._minimap.place_wanted.connect(self._show_place)
        for bar in (self.horizontalScrollBar(), self.verticalScrollBar()):
            bar.valueChanged.connect(self._follow)
        self.scene().shown.connect(self._follow)
        #: The connection that is drawn by hand.
        self.wire = Wire(self)

    # Zoom

    def fit(self) -> None:
        """Show everything, at most at full size, until the user zooms or moves."""
        self.is_chosen = False
        area = self.scene().drawing_area().adjusted(-24, -24, 24, 24)
        if not area.isEmpty():
            self.fitInView(area, Qt.KeepAspectRatio)
            if self.zoom > 1.0:
                self.resetTransform()
                self.centerOn(area.center())
            self._follow()

    def keep_in_view(self) -> None:
        """Fit if something is out of view, or much smaller than it could be.

        Nothing happens if the user has zoomed or moved the view.
        """
        if self.is_chosen:
            return
        seen, area = self.seen, self.scene().drawing_area()
        larger = min(seen.width() / max(area.width(), 1), seen.height() / max(area.height(), 1))
        if not seen.contains(area) or (self.zoom < 0.7 and larger > _ROOM):
            self.fit()

    def reveal(self, items: Iterable[Item]) -> None:
        """Move to items that are not seen, and zoom in until their names can be read."""
        area = QRectF()
        for item in items:
            area = area.united(item.sceneBoundingRect())
        if area.isEmpty() or (self.zoom >= _LEGIBLE and self.seen.contains(area)):
            return
        self.is_chosen = True
        area.adjust(-40, -40, 40, 40)
        room = self.viewport().size()
        whole = min(room.width() / area.width(), room.height() / area.height())
        scale = min(max(self.zoom, _READABLE), whole)
        self.setTransform(QTransform.fromScale(scale, scale))
        self.centerOn(area.center())
        self._follow()

    @property
    def seen(self) -> QRectF:
        """The part of the drawing that is in view."""
        return QRectF(self.mapToScene(self.viewport().rect()).boundingRect())

    @property
    def zoom(self) -> float:
        """The scale: pixels of the screen per pixel of the drawing."""
        return float(self.transform().m11())

    def zoom_by(self, factor: float) -> None:
        self.is_chosen = True
        factor = max(_SMALLEST, min(_LARGEST, self.zoom * factor)) / self.zoom
        self.scale(factor, factor)
        self._follow()

    def resizeEvent(self, event: Any) -> None:  # noqa: N802
        """Fit again, unless the user has zoomed or moved the view."""
        super().resizeEvent(event)
        if not self.is_chosen:
            self.fit()
        self._follow()
        self.resized.emit()

    def wheelEvent(self, event: Any) -> None:  # noqa: N802
        self.zoom_by(_STEP ** (event.angleDelta().y() / 120))

    def viewportEvent(self, event: QEvent) -> bool:  # noqa: N802
        """Handle an event; in Python, so that items are painted without a wait for each of them.

        While other threads are busy, each call from Qt into Python may wait for milliseconds.
        """
        return bool(super().viewportEvent(event))

    # Pointer

    def mousePressEvent(self, event: Any) -> None:  # noqa: N802
        """Start a connection on a port; anything else as usual."""
        is_drag = event.button() == Qt.LeftButton and self.is_editable
        port = self._port_at(event.pos()) if is_drag else None
        if port is None:
            self._pressed = event.pos()
            item = self._item_at(event.pos())
            self._ground = event.pos() if item is None else None
            if item is None and event.modifiers() & Qt.ShiftModifier:
                self.setDragMode(QGraphicsView.RubberBandDrag)
            super().mousePressEvent(event)
            if isinstance(item, VertexItem) and is_drag:
                chosen = self.scene().selectedItems() if item.isSelected() else [item]
                self._starts = {
                    each.vertex.key: each.pos() for each in chosen if isinstance(each, VertexItem)
                }
            return
        self.wire.begin(port)
        self.drag_began.emit(port.ref)
        self._tell_target(port, None, event.pos())

    def mouseMoveEvent(self, event: Any) -> None:  # noqa: N802
        if self._starts and event.buttons() & Qt.LeftButton:
            self._is_moving = self._is_moving or self._is_far_from_press(event.pos())
            if self._is_moving:
                way = self.mapToScene(event.pos()) - self.mapToScene(self._pressed)
                self.scene().move(self._starts, way)
            return
        start = self._drag_start()
        if start is None:
            pans = self._ground is not None and self.dragMode() == QGraphicsView.ScrollHandDrag
            if pans and event.buttons() & Qt.LeftButton:  # a click leaves the view as it is
                self.is_chosen = self.is_chosen or self._is_far_from_press(event.pos())
            super().mouseMoveEvent(event)
            return
        self.wire.lead(start, self.mapToScene(event.pos()))
        self._tell_target(start, self._target_at(event.pos()), event.pos())

    def mouseReleaseEvent(self, event: Any) -> None:  # noqa: N802
        start = self._drag_start()
        if start is None:
            super().mouseReleaseEvent(event)
            self._end_band()
            self._end_move()
            is_still = not self._is_far_from_press(event.pos())
            if is_still and event.button() == Qt.LeftButton and not event.modifiers():
                self.topic_pressed.emit(topic_of(self._item_at(event.pos())))
            return
        self._end_drag()
        target = self._target_at(event.pos())
        way = event.pos() - self.mapFromScene(start.scenePos())
        if target != start.ref and way.manhattanLength() >= QApplication.startDragDistance():
            self.dropped.emit(start.ref, target, self.mapToScene(event.pos()))

    def leaveEvent(self, event: Any) -> None:  # noqa: N802
        super().leaveEvent(event)
        self.scene().highlight(None)

    def mouseDoubleClickEvent(self, event: Any) -> None:  # noqa: N802
        item = self._item_at(event.pos())
        group = self.scene().box_at(self.mapToScene(event.pos()))
        if isinstance(item, VertexItem) and item.vertex.kind is VertexKind.BOX:
            self.box_pressed.emit((*item.vertex.group, item.vertex.name))
        elif group and (item is None or item.is_far):
            self.box_pressed.emit(group)
        else:
            super().mouseDoubleClickEvent(event)

    def contextMenuEvent(self, event: Any) -> None:  # noqa: N802
        """Request a menu on the item under the pointer, or on the selection."""
        if event.reason() == event.Keyboard:
            chosen = self.scene().selectedItems()
            item = chosen[0] if chosen else None
            place = (
                self.mapFromScene(item.sceneBoundingRect().center()) if item else QPoint(10, 10)
            )
        else:
            item, place = self._port_at(event.pos()) or self._item_at(event.pos()), event.pos()
        self.menu_wanted.emit(item, self.viewport().mapToGlobal(place))

    # Keys

    def event(self, event: QEvent) -> bool:
        """Keep Escape from other widgets while a connection is drawn: it ends that."""
        is_key = event.type() == QEvent.ShortcutOverride
        if is_key and event.key() == Qt.Key_Escape and self.wire.start is not None:
            event.accept()
            return True
        return bool(super().event(event))

    def keyPressEvent(self, event: Any) -> None:  # noqa: N802
        """Arrow keys select the next item in their direction; with Ctrl they move the view."""
        key = event.key()
        if key == Qt.Key_Escape and self.wire.start is not None:
            self._end_drag()
        elif key == Qt.Key_Escape:
            self.topic_pressed.emit("")
        elif key in (Qt.Key_Return, Qt.Key_Enter):
            chosen = self.scene().selectedItems()
            self.topic_pressed.emit(topic_of(chosen[0]) if len(chosen) == 1 else "")
        elif key == Qt.Key_Delete and self.is_editable:
            self.delete_pressed.emit()
        elif key in (Qt.Key_Plus, Qt.Key_Equal):
            self._zoom_at_centre(_STEP)
        elif key == Qt.Key_Minus:
            self._zoom_at_centre(1 / _STEP)
        elif key in _ARROWS and event.modifiers() & Qt.ControlModifier:
            self._show_place(self.seen.center() + _ARROWS[key] * (_WAY / self.zoom))
        elif key in _ARROWS:
            self.select_towards(_ARROWS[key])
        else:
            super().keyPressEvent(event)

    def select(self, item: Item) -> None:
        """Select one item only and scroll to it."""
        self.scene().clearSelection()
        item.setSelected(True)
        self.ensureVisible(item.sceneBoundingRect(), 40, 40)

    def select_towards(self, direction: QPointF) -> None:
        """Select the nearest item in a direction from the selected one, or else the leftmost."""
        chosen = [item for item in self.scene().selectedItems() if isinstance(item, VertexItem)]
        ways = []
        for item in self.scene().vertices.values():
            off = item.pos() - chosen[0].pos() if chosen else item.pos()
            along = QPointF.dotProduct(off, direction)
            across = abs(off.x() * direction.y()) + abs(off.y() * direction.x())
            if not chosen:
                ways.append((item.x(), item.y(), item))
            elif along > 1:
                ways.append((along + 2 * across, 0.0, item))
        if ways:
            self.select(min(ways, key=lambda way: way[:2])[2])

    # Inside

    def _follow(self) -> None:
        self.scene().set_zoom(self.zoom * self.devicePixelRatioF(), self.seen)
        if self.scene().has_sticky_titles(self.seen):
            self.viewport().update()  # they do not move with the drawing
        self._minimap.follow(self.seen)

    def _show_place(self, place: QPointF) -> None:
        self.is_chosen = True
        self.centerOn(place)

    def _zoom_at_centre(self, factor: float) -> None:
        self.setTransformationAnchor(QGraphicsView.AnchorViewCenter)
        self.zoom_by(factor)
        self.setTransformationAnchor(QGraphicsView.AnchorUnderMouse)

    def _is_far_from_press(self, place: QPoint) -> bool:
        """Whether the pointer has moved too far for a click."""
        way: int = (place - self._pressed).manhattanLength()
        return way >= int(QApplication.startDragDistance())

    def _end_band(self) -> None:
        """End a rubber band: of arrows and vertices only these are selected."""
        if self.dragMode() == QGraphicsView.RubberBandDrag:
            chosen = self.scene().selectedItems()
            for item in chosen if any(isinstance(item, VertexItem) for item in chosen) else ():
                if isinstance(item, EdgeItem):
                    item.setSelected(False)
            self.setDragMode(QGraphicsView.ScrollHandDrag)
        self.viewport().setCursor(Qt.ArrowCursor)

    def _end_move(self) -> None:
        starts, was_moved = self._starts, self._is_moving
        self._starts, self._is_moving = {}, False
        if was_moved:
            items = self.scene().vertices.items()
            self.moved.emit({k: Point(item.x(), item.y()) for k, item in items if k in starts})

    def _drag_start(self) -> PortItem | None:
        """The port that a connection is drawn from; the drag ends if it has gone."""
        start = self.wire.start
        if start is not None and self.scene().port_item(start.ref) is not start:
            self._end_drag()
        return self.wire.start

    def _end_drag(self) -> None:
        self.wire.end()
        self.scene().offer(None)

    def _tell_target(self, start: PortItem, target: Target, place: QPoint) -> None:
        """Report the port or topic below the wire, and keep the answer beside the pointer."""
        if target != self._target or not self.wire.isVisible():
            self._target = target
            self.dragged.emit(start.ref, target if target != start.ref else None)
        self.wire.stay_beside(place)

    def _target_at(self, place: QPoint) -> Target:
        port, item = self._port_at(place), self._item_at(place)
        if port is not None:
            return port.ref
        if isinstance(item, VertexItem) and item.vertex.kind is VertexKind.TOPIC:
            return item.vertex.name
        return item.edge if isinstance(item, EdgeItem) else None

    def _port_at(self, place: QPoint) -> PortItem | None:
        found: PortItem | None = self._hit(place, PortItem)
        return found

    def _item_at(self, place: QPoint) -> None | EdgeItem | VertexItem:
        found: None | EdgeItem | VertexItem = self._hit(place, VertexItem, EdgeItem)
        return found

    def _hit(self, place: QPoint, *kinds: type) -> Any:
        """The uppermost item of these kinds that is hit at a place, or nearly so; or None."""
        area = QRect(place, place).adjusted(-3, -3, 3, 3)
        items = (item for item in self.items(area) if item.isEnabled())
        return next((item for item in items if isinstance(item, kinds)), None)

    def place_of(self, ref: PortRef) -> QPoint | None:
        port = self.scene().port_item(ref)
        return self.mapFromScene(port.scenePos()) if port is not None else None
