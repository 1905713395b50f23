# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Holds the items of the drawing and updates them with the graph."""

from __future__ import annotations

from typing import Callable, Dict, List, Mapping, Optional, Set, Tuple, Union

from python_qt_binding.QtCore import QObject, QPointF, QRectF
from python_qt_binding.QtGui import QFont, QImage, QPainter, QPalette
from python_qt_binding.QtSvg import QSvgGenerator
from python_qt_binding.QtWidgets import QGraphicsScene

from dyknow.model.graph import PortRef
from dyknow_rqt.canvas.appearance import appearances_of, edge_refs, edge_traffic, port_tip
from dyknow_rqt.canvas.arrows import EdgeItem
from dyknow_rqt.canvas.colours import Tone, colours_of, greys_of
from dyknow_rqt.canvas.items import BoxItem, Item, PortItem
from dyknow_rqt.canvas.vertices import VertexItem
from dyknow_rqt.graph.figure import Edge, Figure, Vertex, VertexKind
from dyknow_rqt.graph.geometry import Layout, Rectangle, Size
from dyknow_rqt.graph.labels import place_labels
from dyknow_rqt.graph.port_order import without_crossings
from dyknow_rqt.graph.rates import PortRate
from dyknow_rqt.graph.snapshot import Snapshot

#: Pixels that can be dragged beyond the drawing.
_MARGIN = 3000.0
_FRAME = 16.0


class GraphScene(QGraphicsScene):
    """The drawing."""

    def __init__(
        self, palette: QPalette, font: QFont, report: Callable[[str], None], parent: QObject
    ) -> None:
        super().__init__(parent)
        self.report = report
        self.figure = Figure()
        self.layout = Layout()
        self.vertices: Dict[str, VertexItem] = {}
        self.edges: Dict[Edge, EdgeItem] = {}
        self._boxes: Dict[Tuple[str, ...], BoxItem] = {}
        self._colours = colours_of(palette)
        self._font = font
        self._snapshot = Snapshot()
        self._traffic: Mapping[PortRef, PortRate] = {}
        self.highlights = True
        self._highlighted: Union[None, str, Edge] = None
        self.setBackgroundBrush(self._colours.paper)

    def show_figure(self, figure: Figure, layout: Layout, sizes: Mapping[str, Size]) -> None:
        """Draw another figure; what is in both keeps its item and its selection."""
        self.figure, self.layout = figure, layout
        self._match(self.vertices, {v.key: v for v in figure.vertices}, self._new_vertex)
        self._match(self.edges, {e: e for e in figure.edges}, self._new_edge)
        self._match(self._boxes, {g: g for g in figure.groups()}, self._new_box)
        for vertex in without_crossings(figure, layout):
            item = self.vertices[vertex.key]
            item.setPos(QPointF(*layout.centres[vertex.key]))
            item.set_vertex(vertex, sizes[vertex.key])
        for edge, arrow in self.edges.items():
            start = self.vertices[edge.tail].anchor(edge.tail_port, leaving=True)
            end = self.vertices[edge.head].anchor(edge.head_port, leaving=False)
            arrow.shows_name = not (edge.tail[0] == "t" or edge.head[0] == "t")
            arrow.set_curve(layout.curves[edge], start, end)
        for group, box in self._boxes.items():
            box.set_area(layout.boxes[group])
        self._place_labels()
        self.setSceneRect(self.drawing_area().adjusted(-_MARGIN, -_MARGIN, _MARGIN, _MARGIN))
        self.set_snapshot(self._snapshot)
        drawn = self._highlighted in self.vertices or self._highlighted in self.edges
        self.highlight(self._highlighted if drawn else None)

    def set_snapshot(self, snapshot: Snapshot) -> None:
        """Show the states of the nodelets that are drawn."""
        self._snapshot = snapshot
        for key, appearance in appearances_of(snapshot, self.figure).items():
            if key in self.vertices:
                self.vertices[key].set_appearance(appearance)
        for item in self.vertices.values():
            for port in item.ports.values():
                state = snapshot.port(port.ref)
                port.is_connected = state is not None and bool(state.topic)
                port.update()
        self.set_traffic(self._traffic)

    def set_traffic(self, traffic: Mapping[PortRef, PortRate]) -> None:
        """Show rates."""
        self._traffic = traffic
        shapes = [item.label_shape for item in self.edges.values()]
        for edge, item in self.edges.items():
            item.set_traffic(edge_traffic(edge, traffic))
            tips = [port_tip(self._snapshot, ref, traffic.get(ref)) for ref in edge_refs(edge)]
            item.setToolTip("\n\n".join(tip for tip in reversed(tips) if tip))
        for item in self.vertices.values():
            for ref, port in ((port.ref, port) for port in item.ports.values()):
                port.setToolTip(port_tip(self._snapshot, ref, traffic.get(ref)))
        if shapes != [item.label_shape for item in self.edges.values()]:
            self._place_labels()

    def set_palette(self, palette: QPalette, is_stale: bool = False) -> None:
        """Use the colours of another palette, or its greys for what is stale."""
        self._colours = greys_of(palette) if is_stale else colours_of(palette)
        self.setBackgroundBrush(self._colours.paper)
        for item in (*self.vertices.values(), *self.edges.values(), *self._boxes.values()):
            item.set_colours(self._colours)

    # Highlighting, searching

    def highlight(self, thing: Union[None, str, Edge]) -> None:
        """Highlight a vertex (red) and its neighbours, or an arrow and its ends, until the next.

        Sources are blue, sinks green, what is both is purple.
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

    def find(self, text: str) -> List[VertexItem]:
        """Mark the vertices whose name contains a text; return them from left to right."""
        wanted = text.strip().lower()
        hits = []
        for item in self.vertices.values():
            item.set_found(bool(wanted) and wanted in item.vertex.name.lower())
            if item.found:
                hits.append(item)
        return sorted(hits, key=lambda item: (item.x(), item.y()))

    # Drawing connections

    def offer(self, refs: Optional[Set[PortRef]]) -> None:
        """Mark the ports where a connection could end; None to mark none."""
        for item in self.vertices.values():
            for port in item.ports.values():
                port.set_offered(None if refs is None else port.ref in refs)

    def port_item(self, ref: PortRef) -> Optional[PortItem]:
        """Return the item of a port, if it is drawn."""
        vertex = self.vertices.get(f"{VertexKind.NODELET.value}_{ref.nodelet}")
        return vertex.ports.get(ref.port) if vertex is not None else None

    # Pictures

    def drawing_area(self) -> QRectF:
        """The area of the drawing."""
        area = QRectF()
        for item in (*self.vertices.values(), *self.edges.values(), *self._boxes.values()):
            area = area.united(item.sceneBoundingRect())
        return area

    def save_svg(self, path: str) -> None:
        """Write the drawing as SVG.

        Raises:
            OSError: the file cannot be written.
        """
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
        """Write the drawing as PNG, or what the name of the file says.

        Raises:
            OSError: the file cannot be written, or the kind of image is not known.
        """
        area = self._picture_area()
        image = QImage((area.size() * scale).toSize(), QImage.Format_ARGB32)
        image.fill(self._colours.paper)
        self._render(image, area)
        if not image.save(path):
            raise OSError(f"cannot write an image to '{path}'")

    # Inside

    def _place_labels(self) -> None:
        areas = [area for item in self.vertices.values() for area in item.inked]
        areas += [box.title_area for box in self._boxes.values()]
        places = place_labels(
            {edge: item.curve for edge, item in self.edges.items()},
            {edge: item.label_size for edge, item in self.edges.items()},
            [
                *(Rectangle(*area.getCoords()) for area in areas),
                *(side for box in self.layout.boxes.values() for side in box.sides),
            ],
        )
        for edge, item in self.edges.items():
            item.place_label(places.get(edge))

    def _picture_area(self) -> QRectF:
        return self.drawing_area().adjusted(-_FRAME, -_FRAME, _FRAME, _FRAME)

    def _render(self, device: object, area: QRectF) -> None:
        painter = QPainter(device)
        painter.setRenderHint(QPainter.Antialiasing)
        self.render(painter, QRectF(), area)
        painter.end()

    def _match(self, items: Dict, wanted: Mapping, make: Callable) -> None:  # type: ignore[type-arg]
        for key in [key for key in items if key not in wanted]:
            self.removeItem(items.pop(key))
        for key, value in wanted.items():
            if key not in items:
                items[key] = make(value)
                self.addItem(items[key])

    def _new_vertex(self, vertex: Vertex) -> Item:
        return VertexItem(vertex, self._colours, self._font)

    def _new_edge(self, edge: Edge) -> Item:
        return EdgeItem(edge, self._colours, self._font)

    def _new_box(self, group: Tuple[str, ...]) -> Item:
        return BoxItem(group, self._colours, self._font)

    def _paint_tones(self, tones: Mapping[object, Tone]) -> None:
        for key, item in (*self.vertices.items(), *self.edges.items()):
            item.set_tone(tones.get(key, Tone.NONE))
