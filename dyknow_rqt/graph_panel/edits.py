# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Turns gestures on the drawing into changes of the graph."""

from __future__ import annotations

from functools import partial
from typing import Mapping, Sequence

from python_qt_binding.QtCore import QObject, QPointF, Qt, Signal
from python_qt_binding.QtWidgets import QMenu, QWidget

from dyknow import names
from dyknow.errors import InvalidName
from dyknow.model.graph import PortRef
from dyknow.model.transformation import Port
from dyknow.wiring.ports import CannotConnect
from dyknow_rqt.canvas.view import GraphView, Target
from dyknow_rqt.graph import changes, wiring
from dyknow_rqt.graph.figure import Edge, VertexKind, edge_refs, key_of
from dyknow_rqt.graph.geometry import Places, Point
from dyknow_rqt.graph.snapshot import Snapshot, not_destroyed
from dyknow_rqt.monitoring.monitor import GraphMonitor
from dyknow_rqt.panels.create import ParametersDialog
from dyknow_rqt.selection import Selection
from dyknow_rqt.status_line import StatusLine

#: So many ports are named, and so many things to make are offered.
_NAMED, _OFFERED = 3, 15
#: The most nodelets that are named in a question; of more, only the tool tip has the names.
_ASKED = 5


class GraphEdits(QObject):
    """Connections drawn by hand, places of moved vertices, and the actions of menus and keys.

    The other parts of the window connect to the signals.
    """

    #: Vertices have other places.
    moved = Signal()
    #: Connect a port; the nodelet, and the port or an empty text.
    connection_wanted = Signal(str, str)
    #: Make a nodelet; the label of its transformation, or an empty text.
    create_wanted = Signal(str)
    #: Show the last message of a topic.
    topic_wanted = Signal(str)

    def __init__(
        self,
        monitor: GraphMonitor,
        view: GraphView,
        selection: Selection,
        line: StatusLine,
        window: QWidget,
    ) -> None:
        super().__init__(window)
        self._monitor, self._view, self._selection = monitor, view, selection
        self._line, self._window = line, window
        self.places = Places()
        view.drag_began.connect(self._drag_began)
        view.dragged.connect(self._dragged)
        view.dropped.connect(self._dropped)
        view.delete_pressed.connect(self._delete)
        view.moved.connect(self._keep)

    # Connections

    def _drag_began(self, ref: PortRef) -> None:
        self._view.scene().offer(set(wiring.partners(self._monitor.snapshot, ref)) | {ref})

    def _dragged(self, start: PortRef, target: Target) -> None:
        """Describe the type of the connection, and its effect if it ends here."""
        port = self._monitor.snapshot.port(start)
        datatype = port.datatype if port is not None else ""
        lines = [datatype or "type not known yet"]
        if target is not None:
            try:
                change = _connection(self._monitor.snapshot, start, target)
            except (CannotConnect, InvalidName) as error:
                lines = [str(error)]
            else:
                topics = sorted({topic for _, topic in change.topics if topic != target})
                over = [f"over {topic}" for topic in topics]
                if not change.topics:
                    over = ["connected already"]
                what = change.text if isinstance(target, Edge) else f"to {target}"
                lines += [what, *over, change.replaced]
        self._view.wire.say("\n".join(line for line in lines if line))

    def _dropped(self, start: PortRef, target: Target, place: QPointF) -> None:
        if target is not None:
            self._monitor.do(lambda snapshot: _connection(snapshot, start, target))
            return
        refs = [str(ref) for ref in wiring.partners(self._monitor.snapshot, start)]
        more = f" and {len(refs) - _NAMED} more" if len(refs) > _NAMED else ""
        fitting = f"a port that fits ({', '.join(refs[:_NAMED])}{more}), or at " if refs else ""
        self._line.note(f"{start} is not connected: end the arrow at {fitting}a topic")
        self._offer(start, place)

    def _offer(self, start: PortRef, place: QPointF) -> None:
        """Offer the transformations that could be made at a place, connected with a port."""
        found = wiring.offers(self._monitor.snapshot, self._monitor.library, start)
        if not found:
            return
        menu = QMenu(self._window)
        menu.setAttribute(Qt.WA_DeleteOnClose)
        menu.addAction("Create and connect").setEnabled(False)  # a section's title may be cut
        for label, port in found[:_OFFERED]:
            action = menu.addAction(f"{label}: {port.name}".replace("&", "&&"))
            action.setToolTip(port.datatype)
            create = partial(self._create, start, label, port, place)
            action.triggered.connect(lambda checked=False, create=create: create())
        if found[_OFFERED:]:
            action = menu.addAction(f"{len(found) - _OFFERED} more …")
            action.triggered.connect(lambda: self.create_wanted.emit(""))
        view = self._view
        menu.popup(view.viewport().mapToGlobal(view.mapFromScene(place)))

    def _create(self, start: PortRef, label: str, port: Port, place: QPointF) -> None:
        def plan(snapshot: Snapshot) -> changes.Change:
            name = wiring.free_name(snapshot, label, names.parent(start.nodelet))
            change = wiring.spawn_at(snapshot, start, label, port, name)
            self.places.put({key_of(VertexKind.NODELET, name): Point(place.x(), place.y())})
            return change

        self._monitor.do(plan)

    # Places

    def _keep(self, places: Mapping[str, Point]) -> None:
        self.places.put(places)
        self.moved.emit()

    # Menus and keys

    def _delete(self) -> None:
        """Disconnect the selected arrows, or else destroy the selected nodelets, after asking."""
        edges = self._selection.edges
        refs = tuple(dict.fromkeys(ref for edge in edges for ref in edge_refs(edge)[:1]))
        if refs:
            self.disconnect_ports(refs)
        elif self._selection.nodelets:
            self.ask_to_destroy(self._selection.nodelets)

    def disconnect_ports(self, refs: tuple[PortRef, ...]) -> None:
        self._monitor.do(lambda snapshot: wiring.disconnect(snapshot, refs))

    def ask_to_destroy(self, nodelets: Sequence[str]) -> None:
        why_not = not_destroyed(nodelets, self._monitor.snapshot)
        if why_not:
            self._line.report(why_not)
            return
        steps = [changes.destroy(name) for name in nodelets]
        question = f"Destroy {', '.join(nodelets)}?"
        if len(nodelets) > _ASKED:
            question = "\n".join([f"Destroy {len(nodelets)} nodelets?", *nodelets])
        self._line.ask(question, "Destroy", lambda: self._monitor.do_in_turn(steps))

    def show_parameters(self, name: str) -> None:
        nodelet = self._monitor.snapshot.nodelet(name)
        if nodelet is not None:
            ParametersDialog(self._monitor, nodelet, self._window).open()


def _connection(snapshot: Snapshot, start: PortRef, target: Target) -> wiring.Rewire:
    if isinstance(target, PortRef):
        return wiring.connect(snapshot, start, target)
    if isinstance(target, Edge):
        return wiring.splice(snapshot, start, target)
    return wiring.connect_topic(snapshot, start, target or "")
