# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Holds the items of the drawing and updates them with the graph."""

from __future__ import annotations

from typing import (
    Any,
    Callable,
    Dict,
    FrozenSet,
    Iterator,
    List,
    Mapping,
    Optional,
    Sequence,
    Set,
    Tuple,
    TypeVar,
    Union,
)

from python_qt_binding.QtCore import QEvent, QObject, QPointF, QRectF, QTimer, Signal
from python_qt_binding.QtGui import QFont, QImage, QPainter, QPalette
from python_qt_binding.QtSvg import QSvgGenerator
from python_qt_binding.QtWidgets import QGraphicsScene, QToolTip

from dyknow.model.graph import PortRef, State
from dyknow_rqt.background_calls import BackgroundCalls, qt_slot
from dyknow_rqt.canvas.appearance import (
    Appearance,
    Colours,
    Tone,
    appearance_of,
    colours_of,
    dead_keys,
    edge_traffic,
    edge_verdict,
    greys_of,
    port_tip,
    vertex_tip,
)
from dyknow_rqt.canvas.arrows import EdgeItem
from dyknow_rqt.canvas.items import BoxItem, Item, PortItem
from dyknow_rqt.canvas.marks import Marks
from dyknow_rqt.canvas.overview import FAR, Overview, paint_marked, paint_titles
from dyknow_rqt.canvas.slices import Slices
from dyknow_rqt.canvas.vertices import VertexItem
from dyknow_rqt.graph.figure import Edge, Figure, Group, VertexKind, key_of
from dyknow_rqt.graph.geometry import (
    Drawing,
    Point,
    Rectangle,
    Size,
    boxes_around,
    curve_between,
    place_labels,
)
from dyknow_rqt.graph.rates import PortRate
from dyknow_rqt.graph.snapshot import Snapshot, Transports, connections_of
from dyknow_rqt.graph.verdicts import PortVerdict
from dyknow_rqt.widgets import wrapped

Key = TypeVar("Key")
#: Pixels that can be dragged beyond the drawing.
_MARGIN = 3000.0
#: Pixels of the largest image that is written.
_MOST_PIXELS = 16_000_000.0
_FRAME = 16.0


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

    def __init__(
        self, palette: QPalette, font: QFont, report: Callable[[str], None], parent: QObject
    ) -> None:
        super().__init__(parent)
        self.report = report
        self.figure = Figure()
        self.vertices: Dict[str, VertexItem] = {}
        self.edges: Dict[Edge, EdgeItem] = {}
        self._boxes: Dict[Tuple[str, ...], BoxItem] = {}
        self._colours = colours_of(palette)
        self._font = font
        self._snapshot = Snapshot()
        self._dead: FrozenSet[str] = frozenset()
        self._traffic: Mapping[PortRef, PortRate] = {}
        self._verdicts: Mapping[PortRef, PortVerdict] = {}
        self._transports: Transports = {}
        self._reshow: Callable[[], None] = lambda: None
        self.highlights = True
        self._highlighted: Union[None, str, Edge] = None
        self._ghosts: Mapping[object, Tone] = {}
        self.overview = Overview()
        self._is_far = self._is_placing = self._wants_labels = False
        self._seen, self._scale = QRectF(), 1.0
        self._marked: Optional[List[Union[EdgeItem, VertexItem]]] = None
        #: Whether a drawing has begun that is not shown yet.
        self.is_drawing = False
        self._drawing = Drawing()
        self._calls = BackgroundCalls(1)
        self.slices = Slices(report, self)
        self.marks = Marks(self)
        self._labelling = QTimer(self)
        self._labelling.setSingleShot(True)
        self._labelling.setInterval(0)
        self._labelling.timeout.connect(self._place_labels)
        self._area: Optional[QRectF] = None
        self.selectionChanged.connect(self.mark)
        self.setBackgroundBrush(self._colours.paper)

    def close_down(self) -> None:
        self._labelling.stop()
        self.slices.close()
        self._calls.close()

    @property
    def is_labelled(self) -> bool:
        """Whether all labels are where they belong."""
        return not (self.is_drawing or self._is_placing or self._labelling.isActive())

    def show_drawing(self, drawing: Drawing) -> None:
        """Draw something else in slices, then emit ``shown``.

        Things in both keep their items and their selection.
        """
        self._drawing = drawing
        self.slices.want(self._draw)
        self.slices.go_on()

    def _draw(self) -> Iterator[None]:
        drawing, self.is_drawing, self._marked = self._drawing, True, None
        figure, layout, sizes = drawing.figure, drawing.layout, drawing.sizes
        drawn = {vertex.key for vertex in figure.vertices}
        for key in [key for key in self.vertices if key not in drawn]:
            if self.marks.keep(self.vertices[key]):
                del self.vertices[key]
        self._remove(self.vertices, drawn)
        self._remove(self.edges, set(figure.edges))
        self._remove(self._boxes, set(figure.groups()))
        for vertex in figure.vertices:
            item = self.vertices.get(vertex.key) or VertexItem(vertex, self._colours, self._font)
            item.setPos(QPointF(*layout.centres[vertex.key]))
            item.set_vertex(vertex, sizes[vertex.key], figure.is_downwards)
            self._show_state(item)
            self._add(self.vertices, vertex.key, item)
            yield
        for edge in figure.edges:
            arrow = self.edges.get(edge) or EdgeItem(edge, self._colours, self._font)
            start = self.vertices[edge.tail].anchor(edge.tail_port, leaving=True)
            end = self.vertices[edge.head].anchor(edge.head_port, leaving=False)
            arrow.shows_name = not (edge.tail[0] == "t" or edge.head[0] == "t")
            arrow.set_curve(layout.curves[edge], start, end)
            self._show_traffic(arrow)
            self._add(self.edges, edge, arrow)
            yield
        for group in figure.groups():
            box = self._boxes.get(group) or BoxItem(group, self._colours, self._font)
            box.set_area(layout.boxes[group])
            self._add(self._boxes, group, box)
        self.figure, self._area = figure, None
        self._labelling.start()
        yield
        self.setSceneRect(self.drawing_area().adjusted(-_MARGIN, -_MARGIN, _MARGIN, _MARGIN))
        is_drawn = self._highlighted in self.vertices or self._highlighted in self.edges
        self.highlight(self._highlighted if is_drawn else None)
        self.marks.apply()
        self.is_drawing, self._marked = False, None
        self.look_again()
        self.shown.emit(drawing)

    def set_snapshot(self, snapshot: Snapshot) -> None:
        self._snapshot, self._dead = snapshot, dead_keys(snapshot)
        self.slices.want(self._show_states)
        self.slices.want(self._show_all_traffic)

    def _show_states(self) -> Iterator[None]:
        for item in list(self.vertices.values()):
            self._show_state(item)
            yield

    def _show_state(self, item: VertexItem) -> None:
        nodelet = self._snapshot.nodelet(item.vertex.name)
        if nodelet is None or item.vertex.kind is not VertexKind.NODELET:
            is_dead = item.vertex.key in self._dead
            item.set_appearance(Appearance(State.LOST if is_dead else State.RUNNING))
            return
        if item.shown is nodelet:
            return
        item.shown = nodelet
        item.set_appearance(appearance_of(nodelet))
        connected = {port.name for port in nodelet.ports if port.topic}
        for port in item.ports.values():
            port.set_connected(port.ref.port in connected)
            port.set_verdict(self._verdicts.get(port.ref))

    def set_traffic(self, traffic: Mapping[PortRef, PortRate]) -> None:
        if traffic != self._traffic:
            self._traffic = traffic
            self.slices.want(self._show_all_traffic)

    def set_verdicts(self, verdicts: Mapping[PortRef, PortVerdict]) -> None:
        before, self._verdicts = self._verdicts, verdicts
        for ref in {*before, *verdicts}:
            port = self.port_item(ref)
            if port is not None:
                port.set_verdict(verdicts.get(ref))
        if verdicts != before:
            self.slices.want(self._show_all_traffic)

    def _show_all_traffic(self) -> Iterator[None]:
        """Update all arrows, and place their labels again if these have other sizes then."""
        for item in list(self.edges.values()):
            if self._show_traffic(item):
                self._wants_labels = True
            yield
        if self._wants_labels:
            self._labelling.start()

    def _show_traffic(self, item: EdgeItem) -> bool:
        """Update an arrow; returns whether its label has another size."""
        traffic, verdict = edge_traffic(item.refs, self._traffic), None
        if self._verdicts:
            verdict = edge_verdict(item.refs, self._verdicts)
        planned, ends = key_of(VertexKind.GHOST, ""), (item.edge.tail, item.edge.head)
        is_dead = any(key in self._dead or key.startswith(planned) for key in ends)
        return item.show(traffic, verdict, is_dead)

    def tip_of(self, item: object) -> str:
        refs = self._refs_of(item)[:1] if isinstance(item, EdgeItem) else self._refs_of(item)
        connections = connections_of(self._snapshot, refs, self._transports)
        connections = f"connections: {connections}" if connections else ""
        if isinstance(item, VertexItem):
            tip = vertex_tip(self._snapshot, item.vertex, self._verdicts)
            return "\n".join(part for part in (tip, connections) if part)
        tips = [
            port_tip(self._snapshot, ref, self._traffic.get(ref), self._verdicts.get(ref))
            for ref in self._refs_of(item)
        ]
        return "\n\n".join(tip for tip in (*tips, connections) if tip)

    def _refs_of(self, item: object) -> List[PortRef]:
        """The ports whose connections an item shows, sources first."""
        if isinstance(item, EdgeItem):
            return item.refs[::-1]
        if isinstance(item, VertexItem) and item.vertex.kind is VertexKind.TOPIC:
            topic = self._snapshot.topics().get(item.vertex.name)
            return list(topic.sources or topic.targets) if topic is not None else []
        return [item.ref] if isinstance(item, PortItem) else []

    @qt_slot
    def helpEvent(self, event: Any) -> None:  # noqa: N802
        """Show a tool tip: there are too many to keep them up to date."""
        items = self.items(event.scenePos())
        item = next((item for item in items if self.tip_of(item)), None)

        def show() -> None:
            QToolTip.showText(event.screenPos(), wrapped(self.tip_of(item)), event.widget())

        show()
        nodelets = [self._snapshot.nodelet(ref.nodelet) for ref in self._refs_of(item)]
        nodes = frozenset(nodelet.node for nodelet in nodelets if nodelet is not None)
        self._reshow = show
        if nodes:
            self.transports_wanted.emit(nodes)

    def set_transports(self, transports: Transports) -> None:
        """Take the transports that the tool tip has asked for."""
        self._transports = transports
        if QToolTip.isVisible():
            self._reshow()

    # Painting

    def set_zoom(self, zoom: float, seen: Optional[QRectF] = None) -> None:
        """Let the overview paint things that are too small for names.

        Args:
            zoom: pixels of the screen per pixel of the drawing.
            seen: the part of the drawing that is in view.
        """
        self._seen, self._scale = seen or self._seen, zoom
        if self._is_far != (zoom < FAR):
            self._is_far = zoom < FAR
            for item in self._items():
                item.set_far(self._is_far)
            if self._wants_labels:
                self._labelling.start()
        shown = self.overview.area.contains(self._seen & self.drawing_area())
        if self._is_far and not (shown and abs(self.overview.scale - zoom) < 1e-9):
            self.slices.want(self._picture)

    def _picture(self) -> Iterator[None]:
        """Paint the overview of what is seen, and of as much again around it."""
        seen = self._seen
        across, down = seen.width() / 2, seen.height() / 2
        area = seen.adjusted(-across, -down, across, down) & self.drawing_area()
        if self._is_far and not area.isEmpty():
            yield from self.overview_of(self.overview, area, self._scale)
            self.update()

    def overview_of(self, overview: Overview, area: QRectF, scale: float) -> Iterator[None]:
        boxes = sorted(self._boxes.values(), key=lambda box: box.zValue())
        edges, vertices = list(self.edges.values()), list(self.vertices.values())
        yield from overview.painted(area, scale, self._colours.paper, boxes, edges, vertices)

    @qt_slot
    def drawForeground(self, painter: QPainter, area: QRectF) -> None:  # noqa: N802
        """Paint the things that are not painted by items."""
        boxes = sorted(self._boxes.items(), key=lambda each: (len(each[0]), each[0]))
        titles = [(box.area, box.name) for _, box in boxes]
        seen = painter.worldTransform().inverted()[0].mapRect(QRectF(painter.viewport()))
        if self._is_far:
            self.overview.paint(painter)
            self.paint_marked(painter)
            titles += [
                (item.area.translated(item.pos()), item.vertex.name)
                for item in self.vertices.values()
                if item.vertex.kind is VertexKind.BOX
            ]
        paint_titles(painter, titles, self._font, self._colours, seen)

    def has_sticky_titles(self, seen: QRectF) -> bool:
        """Whether boxes are seen without the corner where their title belongs."""
        areas = [box.area for box in self._boxes.values()]
        return any(a.intersects(seen) and not seen.contains(a.topLeft()) for a in areas)

    def paint_marked(self, painter: QPainter) -> None:
        """Paint what stands out on top of a picture."""
        if self._marked is None:
            items = (*self.edges.values(), *self.vertices.values())
            self._marked = [item for item in items if item.stands_out]
        paint_marked(painter, self._marked)

    @qt_slot
    def look_again(self) -> None:
        """Have the overviews painted again: something looks different now."""
        self.slices.want(self._tell_looks)

    def _tell_looks(self) -> Iterator[None]:
        self.changed_looks.emit()
        if self._is_far:
            self.slices.want(self._picture)
        yield

    @qt_slot
    def mark(self) -> None:
        """Show what stands out now."""
        self._marked = None
        if self._is_far:
            self.update()
        self.changed_marks.emit()

    def event(self, event: QEvent) -> bool:
        """Handle an event; in Python, so that items are queried without waits."""
        return bool(super().event(event))

    @property
    def colours(self) -> Colours:
        return self._colours

    def show_past(self, is_past: bool) -> None:
        """Draw on another ground while what is drawn is no more."""
        self.setBackgroundBrush(self._colours.topic if is_past else self._colours.paper)

    def set_palette(self, palette: QPalette, is_stale: bool = False) -> None:
        """Use the colours of another palette, or its greys for stale contents."""
        self._colours = greys_of(palette) if is_stale else colours_of(palette)
        self.setBackgroundBrush(self._colours.paper)
        for item in self._items():
            item.set_colours(self._colours)

    # Highlighting, searching

    def highlight(self, thing: Union[None, str, Edge]) -> None:
        """Highlight a vertex (red) and its neighbours, or an arrow and its ends, until the next.

        Sources are blue, sinks green, things that are both are purple.
        """
        self._highlighted = thing
        tones: Dict[object, Tone] = {}
        if not self.highlights:
            pass
        elif isinstance(thing, Edge):
            tones = {thing: Tone.SELF, thing.tail: Tone.IN, thing.head: Tone.OUT}
        elif thing is not None:
            key = thing
            before = {e.tail for e in self.figure.edges if e.head == key}
            after = {e.head for e in self.figure.edges if e.tail == key}
            for edge in self.figure.edges:
                if edge.head == key or edge.tail == key:
                    both = edge.head == edge.tail
                    side = Tone.IN if edge.head == key else Tone.OUT
                    tones[edge] = Tone.BOTH if both else side
            for other in before | after:
                side = Tone.IN if other in before else Tone.OUT
                tones[other] = Tone.BOTH if other in before & after else side
            tones[key] = Tone.SELF
        self._paint_tones(tones)

    def show_ghosts(self, fates: Mapping[str, bool]) -> None:
        """Tint the vertices that a plan uses on (True), strike out those that it drops."""
        self._ghosts = {key: Tone.KEPT if kept else Tone.DROPPED for key, kept in fates.items()}
        self.highlight(self._highlighted)

    def find(self, text: str) -> List[VertexItem]:
        """Mark the vertices whose name contains a text; return them from left to right."""
        wanted = text.strip().lower()
        hits = []
        for item in self.vertices.values():
            item.set_found(bool(wanted) and wanted in item.vertex.name.lower())
            if item.found:
                hits.append(item)
        self.mark()
        return sorted(hits, key=lambda item: (item.x(), item.y()))

    def box_at(self, place: QPointF) -> Group:
        """The innermost open box at a place of the drawing; empty if there is none."""
        found = [group for group, box in self._boxes.items() if box.area.contains(place)]
        return max(found, key=len, default=())

    def move(self, starts: Mapping[str, QPointF], by: QPointF) -> None:
        """Move vertices from where they were, with their arrows and boxes."""
        for key in starts.keys() & self.vertices.keys():
            self.vertices[key].setPos(starts[key] + by)
        for edge, arrow in self.edges.items():
            if edge.tail in starts or edge.head in starts:
                start = self.vertices[edge.tail].anchor(edge.tail_port, leaving=True)
                end = self.vertices[edge.head].anchor(edge.head_port, leaving=False)
                arrow.set_curve(self._curve(start, end), start, end)
        items = self.vertices.items()
        groups = {key: item.vertex.group for key, item in items}
        centres = {key: Point(item.x(), item.y()) for key, item in items}
        sizes = {key: item.size for key, item in items}
        for group, area in boxes_around(groups, centres, sizes).items():
            self._boxes[group].set_area(area)
        self._area = None
        self.look_again()

    def _curve(self, start: QPointF, end: QPointF) -> Sequence[Point]:
        is_turned, none = self.figure.is_downwards, Size(0, 0)
        ends = [Point(p.y(), p.x()) if is_turned else Point(p.x(), p.y()) for p in (start, end)]
        curve = curve_between(ends[0], none, ends[1], none)
        return tuple(Point(y, x) for x, y in curve) if is_turned else curve

    # Drawing connections

    def offer(self, refs: Optional[Set[PortRef]]) -> None:
        """Mark the ports where a connection could end; None to mark none."""
        for item in self.vertices.values():
            for port in item.ports.values():
                port.set_offered(None if refs is None else port.ref in refs)

    def port_item(self, ref: PortRef) -> Optional[PortItem]:
        vertex = self.vertices.get(f"{VertexKind.NODELET.value}_{ref.nodelet}")
        return vertex.ports.get(ref.port) if vertex is not None else None

    # Pictures

    def drawing_area(self) -> QRectF:
        if self._area is None:
            self._area = self.itemsBoundingRect()
        return QRectF(self._area)

    def save_svg(self, path: str) -> None:
        """Write the drawing as SVG, or raise OSError."""
        area = self._picture_area()
        with open(path, "wb"):
            pass  # the generator ignores files that it cannot write
        generator = QSvgGenerator()
        generator.setFileName(path)
        generator.setSize(area.size().toSize())
        generator.setViewBox(QRectF(0, 0, area.width(), area.height()))
        generator.setTitle("DyKnow computation graph")
        self._render(generator, area)

    def save_image(self, path: str, scale: float = 2.0) -> None:
        """Write the drawing as an image; the ending of the file says of which kind.

        Large drawings are written smaller than `scale` says, so that they fit into memory.

        Raises:
            OSError: the file cannot be written, or the kind of image is not known.
        """
        area = self._picture_area()
        scale = min(scale, (_MOST_PIXELS / (area.width() * area.height())) ** 0.5)
        image = QImage((area.size() * scale).toSize(), QImage.Format_ARGB32)
        image.fill(self._colours.paper)
        self._render(image, area)
        if not image.save(path):
            raise OSError(f"cannot write an image to '{path}'")

    # Inside

    @qt_slot
    def _place_labels(self) -> None:
        """Place the labels of arrows, in a thread; not before they are large enough to be read."""
        self._wants_labels = True
        if not self._is_far and not self._is_placing:
            self._is_placing, self._wants_labels = True, False
            self._calls.run(self._labels(), self._take_labels, self._take_no_labels)

    def _labels(self) -> Callable[[], Mapping[Edge, Rectangle]]:
        """Return a function that finds places for the labels, in any thread."""
        areas = [area for item in self.vertices.values() for area in item.inked]
        areas += [box.title_area for box in self._boxes.values()]
        curves = {edge: item.curve for edge, item in self.edges.items()}
        sizes = {edge: item.label_size for edge, item in self.edges.items()}
        obstacles = [Rectangle(*area.getCoords()) for area in areas]
        obstacles += [
            side for box in self._boxes.values() for side in Rectangle(*box.area.getCoords()).sides
        ]
        return lambda: place_labels(curves, sizes, obstacles)

    def _take_labels(self, places: Mapping[Edge, Rectangle]) -> None:
        for edge, item in self.edges.items():
            item.place_label(places.get(edge))
        self._is_placing, self._area = False, None
        if self._wants_labels:
            self._labelling.start()

    def _take_no_labels(self, error: Exception) -> None:
        self._is_placing = False
        raise error

    def _picture_area(self) -> QRectF:
        return self.drawing_area().adjusted(-_FRAME, -_FRAME, _FRAME, _FRAME)

    def _render(self, device: object, area: QRectF) -> None:
        was_far = self._is_far
        self.set_zoom(1.0)
        self._take_labels(self._labels()())
        painter = QPainter(device)
        painter.setRenderHint(QPainter.Antialiasing)
        self.render(painter, QRectF(), area)
        painter.end()
        self.set_zoom(0.0 if was_far else 1.0)

    def _items(self) -> Iterator[Item]:
        yield from self.vertices.values()
        yield from self.edges.values()
        yield from self._boxes.values()

    def _remove(self, items: Dict[Key, Any], wanted: Set[Key]) -> None:
        for key in [key for key in items if key not in wanted]:
            self.removeItem(items.pop(key))

    def _add(self, items: Dict[Key, Any], key: Key, item: Item) -> None:
        if key not in items:
            items[key] = item
            item.set_far(self._is_far)
            self.addItem(item)

    def _paint_tones(self, tones: Mapping[object, Tone]) -> None:
        for key, item in (*self.vertices.items(), *self.edges.items()):
            item.set_tone(tones.get(key, self._ghosts.get(key, Tone.NONE)))
        self.mark()
