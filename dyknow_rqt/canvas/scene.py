# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Holds the items of the drawing and updates them with the graph."""

from __future__ import annotations

from typing import Any, Callable, Iterator, Mapping, Sequence, TypeVar

from python_qt_binding.QtCore import QEvent, QObject, QPointF, QRectF, Qt, Signal
from python_qt_binding.QtGui import QFont, QPainter, QPalette
from python_qt_binding.QtWidgets import QGraphicsScene, QToolTip

from dyknow.model.graph import PortRef
from dyknow_rqt.background_calls import Slices
from dyknow_rqt.canvas.appearance import Tone, colours_of, greys_of, tones_around
from dyknow_rqt.canvas.arrows import ArrowLabels, EdgeItem
from dyknow_rqt.canvas.facts import Facts
from dyknow_rqt.canvas.items import BoxItem, Item, PortItem
from dyknow_rqt.canvas.marks import Marks
from dyknow_rqt.canvas.overview import FAR, Overview, paint_marked, paint_titles
from dyknow_rqt.canvas.vertices import VertexItem
from dyknow_rqt.graph.figure import Edge, Figure, Group, VertexKind
from dyknow_rqt.graph.geometry import Drawing, Point, Size, boxes_around, curve_between
from dyknow_rqt.graph.measurements import PortRate, PortVerdict, Strain
from dyknow_rqt.graph.snapshot import Snapshot, Transports
from dyknow_rqt.widgets import wrapped

Key = TypeVar("Key")
#: Pixels that can be dragged beyond the drawing.
_MARGIN = 3000.0


class GraphScene(QGraphicsScene):
    """The drawing."""

    #: Something looks different now.
    changed_looks = Signal()
    #: Other things stand out now.
    changed_marks = Signal()
    #: The transports of the connections of these nodes are wanted.
    transports_wanted = Signal(object)
    #: A ``Drawing`` is drawn.
    shown = Signal(object)

    def __init__(self, palette: QPalette, font: QFont, parent: QObject) -> None:
        super().__init__(parent)
        self.figure = Figure()
        self.vertices: dict[str, VertexItem] = {}
        self.edges: dict[Edge, EdgeItem] = {}
        self.boxes: dict[Group, BoxItem] = {}
        self.colours = colours_of(palette)
        self.typeface = font
        self.facts = Facts()
        self._reshow: Callable[[], None] = lambda: None
        self.highlights = True
        self._highlighted: None | str | Edge = None
        self._ghosts: Mapping[object, Tone] = {}
        self.overview = Overview()
        self.is_far = False
        self._seen, self.zoom = QRectF(), 1.0
        self._marked: list[EdgeItem | VertexItem] | None = None
        self._drawing = Drawing()
        self.slices = Slices(self)
        self.marks = Marks(self)
        self.labels = ArrowLabels(self)
        self._area: QRectF | None = None
        self.selectionChanged.connect(self.mark)
        self.setBackgroundBrush(self.colours.paper)

    def close_down(self) -> None:
        self.labels.close()
        self.slices.close()

    @property
    def things(self) -> dict[Any, EdgeItem | VertexItem]:
        """Arrows and vertices by their keys."""
        return {**self.edges, **self.vertices}

    def show_drawing(self, drawing: Drawing) -> None:
        """Draw something else in slices, then emit ``shown``.

        Things in both keep their items and their selection.
        """
        self._drawing = drawing
        self.slices.want(self._draw)
        self.slices.go_on()

    def _draw(self) -> Iterator[None]:
        drawing, self._marked = self._drawing, None
        figure, layout, sizes = drawing.figure, drawing.layout, drawing.sizes
        drawn = {vertex.key for vertex in figure.vertices}
        for key in [key for key in self.vertices if key not in drawn]:
            if self.marks.keep(self.vertices[key]):
                del self.vertices[key]
        self._remove(self.vertices, drawn)
        self._remove(self.edges, set(figure.edges))
        self._remove(self.boxes, set(figure.groups()))
        for vertex in figure.vertices:
            item = self.vertices.get(vertex.key) or VertexItem(vertex, self.colours, self.typeface)
            item.setPos(QPointF(*layout.centres[vertex.key]))
            item.set_vertex(vertex, sizes[vertex.key], figure.is_downwards)
            self.facts.show_vertex(item)
            self._add(self.vertices, vertex.key, item)
            yield
        for edge in figure.edges:
            arrow = self.edges.get(edge) or EdgeItem(edge, self.colours, self.typeface)
            self._lead(arrow, layout.curves[edge])
            self.facts.show_arrow(arrow)
            self._add(self.edges, edge, arrow)
            yield
        for group in figure.groups():
            box = self.boxes.get(group) or BoxItem(group, self.colours, self.typeface)
            box.set_area(layout.boxes[group])
            self._add(self.boxes, group, box)
        self.figure, self._area = figure, None
        self.labels.place()
        yield
        self.setSceneRect(self.drawing_area().adjusted(-_MARGIN, -_MARGIN, _MARGIN, _MARGIN))
        is_drawn = self._highlighted in self.things
        self.highlight(self._highlighted if is_drawn else None)
        self.marks.apply()
        self._marked = None
        self.look_again()
        self.shown.emit(drawing)

    def set_snapshot(self, snapshot: Snapshot) -> None:
        self.facts.take(snapshot)
        self._show_again()

    def _show_again(self) -> None:
        self.slices.want(self._show_states)
        self.slices.want(self._show_all_traffic)

    def _show_states(self) -> Iterator[None]:
        for item in list(self.vertices.values()):
            self.facts.show_vertex(item)
            yield

    def set_traffic(
        self, traffic: Mapping[PortRef, PortRate], strains: Mapping[str, Strain]
    ) -> None:
        """Show the traffic of ports, and the strains of nodelets by name."""
        if (traffic, strains) != (self.facts.traffic, self.facts.strains):
            self.facts.traffic, self.facts.strains = traffic, strains
            self._show_again()

    def set_verdicts(self, verdicts: Mapping[PortRef, PortVerdict]) -> None:
        if verdicts != self.facts.verdicts:
            self.facts.verdicts = verdicts
            self._show_again()

    def _show_all_traffic(self) -> Iterator[None]:
        """Update all arrows, and place their labels again if these have other sizes then."""
        for item in list(self.edges.values()):
            if self.facts.show_arrow(item):
                self.labels.are_wanted = True
            yield
        if self.labels.are_wanted:
            self.labels.place()

    def helpEvent(self, event: Any) -> None:  # noqa: N802
        """Show a tool tip: there are too many to keep them up to date."""
        items = self.items(event.scenePos())
        item = next((item for item in items if self.facts.tip_of(item)), None)

        def show() -> None:
            text = wrapped(self.facts.tip_of(item))
            QToolTip.showText(event.screenPos(), text, event.widget())

        show()
        self._reshow = show
        nodes = self.facts.nodes_of(item)
        if nodes:
            self.transports_wanted.emit(nodes)

    def set_transports(self, transports: Transports) -> None:
        """Take the transports that the tool tip shows."""
        self.facts.transports = transports
        if QToolTip.isVisible():
            self._reshow()

    # Painting

    def set_zoom(self, zoom: float, seen: QRectF | None = None) -> None:
        """Let the overview paint things that are too small for names.

        The zoom is in pixels of the screen per pixel of the drawing, of which a part is seen.
        """
        self._seen, self.zoom = seen or self._seen, zoom
        if self.is_far != (zoom < FAR):
            self.is_far = zoom < FAR
            for item in self._items():
                item.set_far(self.is_far)
            if self.labels.are_wanted:
                self.labels.place()
        shown = self.overview.area.contains(self._seen & self.drawing_area())
        if self.is_far and not (shown and abs(self.overview.scale - zoom) < 1e-9):
            self.slices.want(self._picture)

    def _picture(self) -> Iterator[None]:
        """Paint the overview of the visible part, and of as much again around it."""
        seen = self._seen
        across, down = seen.width() / 2, seen.height() / 2
        area = seen.adjusted(-across, -down, across, down) & self.drawing_area()
        if self.is_far and not area.isEmpty():
            yield from self.overview.painted(self, area, self.zoom)
            self.update()

    def drawForeground(self, painter: QPainter, area: QRectF) -> None:  # noqa: N802
        """Paint the things that are not painted by items."""
        boxes = sorted(self.boxes.items(), key=lambda each: (len(each[0]), each[0]))
        titles = [(box.area, box.name) for _, box in boxes]
        seen = painter.worldTransform().inverted()[0].mapRect(QRectF(painter.viewport()))
        if self.is_far:
            self.overview.paint(painter)
            self.paint_marked(painter)
            titles += [
                (item.area.translated(item.pos()), item.vertex.name)
                for item in self.vertices.values()
                if item.vertex.kind is VertexKind.BOX
            ]
        paint_titles(painter, titles, self.typeface, self.colours, seen)

    def has_sticky_titles(self, seen: QRectF) -> bool:
        """Whether boxes are seen without the corner where their title belongs."""
        areas = [box.area for box in self.boxes.values()]
        return any(a.intersects(seen) and not seen.contains(a.topLeft()) for a in areas)

    def paint_marked(self, painter: QPainter) -> None:
        """Paint the items that stand out on top of a picture."""
        if self._marked is None:
            self._marked = [item for item in self.things.values() if item.stands_out]
        paint_marked(painter, self._marked)

    def look_again(self) -> None:
        """Have the overviews painted again: something looks different now."""
        self.slices.want(self._tell_looks)

    def _tell_looks(self) -> Iterator[None]:
        self.changed_looks.emit()
        if self.is_far:
            self.slices.want(self._picture)
        yield

    def mark(self) -> None:
        """Show the items that stand out now."""
        self._marked = None
        if self.is_far:
            self.update()
        self.changed_marks.emit()

    def event(self, event: QEvent) -> bool:
        """Handle an event; in Python, so that items are queried without waits."""
        return bool(super().event(event))

    def show_past(self, is_past: bool) -> None:
        """Draw on another ground while the drawing shows the past."""
        self.setBackgroundBrush(self.colours.topic if is_past else self.colours.paper)

    def set_palette(self, palette: QPalette, is_stale: bool = False) -> None:
        """Use the colours of another palette, or its greys for stale contents."""
        self.colours = greys_of(palette) if is_stale else colours_of(palette)
        for item in self._items():
            item.set_colours(self.colours)

    # Highlighting, searching

    def highlight(self, thing: None | str | Edge) -> None:
        """Highlight a vertex (red) and its neighbours, or an arrow and its ends, until the next.

        Sources are blue, sinks green, things that are both are purple.
        """
        self._highlighted = thing
        tones: dict[object, Tone] = {}
        if self.highlights and thing is not None:
            tones = tones_around(self.figure, thing)
        for key, item in self.things.items():
            item.change(tone=tones.get(key, self._ghosts.get(key, Tone.NONE)))
        self.mark()

    def show_ghosts(self, fates: Mapping[str, bool]) -> None:
        """Tint the vertices that a plan uses on (True), strike out those that it drops."""
        before = self._ghosts
        self._ghosts = {key: Tone.KEPT if kept else Tone.DROPPED for key, kept in fates.items()}
        if self._ghosts != before:
            self.highlight(self._highlighted)

    def find(self, text: str) -> list[VertexItem]:
        """Mark the vertices whose name contains a text; return them from left to right."""
        wanted, items = text.strip().lower(), self.vertices.values()
        for item in items:
            item.change(found=bool(wanted) and wanted in item.vertex.name.lower())
        self.mark()
        hits = [item for item in items if item.found]
        return sorted(hits, key=lambda item: (item.x(), item.y()))

    def box_at(self, place: QPointF) -> Group:
        """The innermost open box at a place of the drawing; empty if there is none."""
        found = [group for group, box in self.boxes.items() if box.area.contains(place)]
        return max(found, key=len, default=())

    def move(self, starts: Mapping[str, QPointF], by: QPointF) -> None:
        """Move vertices from where they were, with their arrows and boxes."""
        for key in starts.keys() & self.vertices.keys():
            self.vertices[key].setPos(starts[key] + by)
        for edge, arrow in self.edges.items():
            if edge.tail in starts or edge.head in starts:
                self._lead(arrow)
        items = self.vertices.items()
        groups = {key: item.vertex.group for key, item in items}
        centres = {key: Point(item.x(), item.y()) for key, item in items}
        sizes = {key: item.size for key, item in items}
        for group, area in boxes_around(groups, centres, sizes).items():
            if group in self.boxes:  # else that of a vertex whose drawing is under way
                self.boxes[group].set_area(area)
        self._area = None
        self.look_again()

    def offer(self, refs: set[PortRef] | None) -> None:
        """Mark the ports where a connection could end; None to mark none."""
        for item in self.vertices.values():
            for port in item.ports.values():
                port.set_offered(None if refs is None else port.ref in refs)

    def port_item(self, ref: PortRef) -> PortItem | None:
        vertex = self.vertices.get(f"{VertexKind.NODELET.value}_{ref.nodelet}")
        return vertex.ports.get(ref.port) if vertex is not None else None

    def is_free(self, area: QRectF) -> bool:
        """Return whether no arrow's label is in an area."""
        near = self.items(area, Qt.IntersectsItemBoundingRect)
        arrows = (item for item in near if isinstance(item, EdgeItem))
        return not any(item.label_area.intersects(area) for item in arrows)

    def drawing_area(self) -> QRectF:
        if self._area is None:
            self._area = self.itemsBoundingRect()
        return QRectF(self._area)

    def measure(self) -> None:
        """Measure the drawing again: an item has another place or size."""
        self._area = None

    # Inside

    def _lead(self, arrow: EdgeItem, curve: Sequence[Point] = ()) -> None:
        """Lead an arrow from port to port, along a curve or as straight as it goes."""
        edge, none = arrow.edge, Size(0, 0)
        start = self.vertices[edge.tail].anchor(edge.tail_port, leaving=True)
        end = self.vertices[edge.head].anchor(edge.head_port, leaving=False)
        if not curve:
            ends = [Point(place.x(), place.y()) for place in (start, end)]
            if self.figure.is_downwards:
                ends = [end.turned for end in ends]
            curve = curve_between(ends[0], none, ends[1], none)
            if self.figure.is_downwards:
                curve = [place.turned for place in curve]
        arrow.set_curve(curve, start, end)

    def _items(self) -> Iterator[Item]:
        yield from self.vertices.values()
        yield from self.edges.values()
        yield from self.boxes.values()

    def _remove(self, items: dict[Key, Any], wanted: set[Key]) -> None:
        for key in [key for key in items if key not in wanted]:
            self.removeItem(items.pop(key))

    def _add(self, items: dict[Key, Any], key: Key, item: Item) -> None:
        if key not in items:
            items[key] = item
            item.set_far(self.is_far)
            self.addItem(item)
