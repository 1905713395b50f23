# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The graph with its bar: draws the monitor's snapshot, and turns gestures into changes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Mapping, Sequence

from python_qt_binding.QtCore import QEvent, QPoint, Qt, QTimer
from python_qt_binding.QtWidgets import QMenu, QWidget

from dyknow.model.graph import PortRef
from dyknow_rqt.background_calls import BackgroundCalls
from dyknow_rqt.canvas.appearance import gap_of, sizes_of
from dyknow_rqt.canvas.items import Item, PortItem
from dyknow_rqt.canvas.view import GraphView
from dyknow_rqt.graph.figure import Figure, figure_of
from dyknow_rqt.graph.geometry import Drawing
from dyknow_rqt.graph.layout import DrawingOrder
from dyknow_rqt.graph.measurements import PortRate, PortVerdict
from dyknow_rqt.graph.snapshot import Difference, GraphMoment, Snapshot
from dyknow_rqt.graph.ways import WayPart, fates_of, with_ghosts
from dyknow_rqt.graph_panel.bar import GraphBar
from dyknow_rqt.graph_panel.edits import GraphEdits
from dyknow_rqt.graph_panel.files import GraphFiles
from dyknow_rqt.graph_panel.layouter import Layouter
from dyknow_rqt.graph_panel.menus import menu_of, menu_of_ground, menu_of_port
from dyknow_rqt.graph_panel.timeline import TimelinePanel
from dyknow_rqt.graph_panel.topic_card import TopicCard
from dyknow_rqt.monitoring.monitor import GraphMonitor
from dyknow_rqt.selection import Selection
from dyknow_rqt.status_line import StatusLine
from dyknow_rqt.widgets import Sign, bare_column_in

#: Milliseconds that a view must keep its size before the graph follows.
_TURNING = 200
#: So many nodelets that come and go at once are marked, or half of all.
_MARKED = 10
#: A view whose shape changes by this factor is filled again.
_RESHAPED = 1.3


class GraphPanel(QWidget):
    """Bar, drawing, and a message when there is nothing to draw."""

    def __init__(self, monitor: GraphMonitor, selection: Selection, line: StatusLine) -> None:
        super().__init__()
        self._monitor, self._selection, self._line = monitor, selection, line
        self._is_following = False
        self._order = DrawingOrder()
        self._has_fitted = self._wants_tidy = False
        self._plan: Sequence[WayPart] = ()
        self._calls = BackgroundCalls(1)
        self._turning = QTimer(self, singleShot=True, interval=_TURNING, timeout=self._turn)
        self.bar = GraphBar()
        self.view = GraphView()
        self.edits = GraphEdits(monitor, self.view, selection, line, self)
        self.layouter = Layouter()
        self.timeline = TimelinePanel(monitor)
        self.files = GraphFiles(monitor, self.view.scene(), self.bar, self)
        self.sign = Sign(self.view)
        self.card = TopicCard(monitor, self.view)
        bare_column_in(self, self.bar, self.view, self.timeline).setStretch(1, 1)
        self.view.installEventFilter(self)
        self._listen()
        self._show_sign()

    def close_down(self) -> None:
        self._calls.close()
        self.card.close_down()
        self.layouter.close()
        self.view.scene().close_down()

    @property
    def drawn(self) -> Figure:
        figure: Figure = self.view.scene().figure
        return figure

    @property
    def _snapshot(self) -> Snapshot:
        """The one that is shown: of the present or of the past."""
        past = self.timeline.moment
        return self._monitor.snapshot if past is None else past.snapshot

    # Drawing

    def redraw(self) -> None:
        """Draw the changes; a new layout is made only if vertices or edges came, went or moved."""
        snapshot, plan = self._snapshot, self._plan if self.timeline.moment is None else ()
        self.view.scene().show_ghosts(fates_of(plan))
        options = self.bar.options(self.view.viewport().size())
        self._calls.run_once(
            "the figure",
            lambda: with_ghosts(figure_of(snapshot, options), snapshot, plan),
            lambda figure: self._take_figure(snapshot, figure),
            again=True,
        )

    def _take_figure(self, snapshot: Snapshot, figure: Figure) -> None:
        self.bar.nodelets.set_names(each.name for each in snapshot.nodelets)
        self.bar.topics.set_names(snapshot.topics())
        self.view.scene().set_snapshot(snapshot)
        if self.timeline.moment is None:
            self.edits.places.follow(each.name for each in snapshot.nodelets)
        font, places, shape = self.view.font(), dict(self.edits.places.present), self._shape
        sizes, gap = sizes_of(figure, font), gap_of(font)
        order = DrawingOrder(figure, sizes, gap, shape, places=places)
        if order != self._order or self._wants_tidy:
            self._order = order
            self.layouter.lay_out(replace(order, anew=self._wants_tidy))
            self._wants_tidy = False
        self._show_sign()

    def show_plan(self, parts: Sequence[WayPart]) -> None:
        """Draw a plan that is not made yet over the graph; none of it ends that."""
        if tuple(parts) != self._plan:
            self._plan = tuple(parts)
            self.redraw()

    def tidy(self) -> None:
        """Make a new layout without regard to the old one."""
        self._wants_tidy = True
        self.redraw()

    def tidy_all(self) -> None:
        """Make a new layout that forgets the places of vertices that the user has moved."""
        self.edits.places.forget()
        self.tidy()

    def _show_moment(self, moment: GraphMoment | None, found: Difference) -> None:
        """Show the graph as it was, without rates and verdicts, or as it is."""
        scene, is_past = self.view.scene(), moment is not None
        scene.show_past(is_past)
        self.view.is_editable = not is_past
        scene.marks.clear()
        scene.marks.show(found, is_lasting=is_past)
        self._show_traffic(self._monitor.traffic)
        self._show_verdicts(self._monitor.verdicts)
        self.redraw()

    def _show_traffic(self, traffic: Mapping[PortRef, PortRate]) -> None:
        seen = (traffic, self._monitor.strains) if self.timeline.moment is None else ({}, {})
        self.view.scene().set_traffic(*seen)

    def _show_verdicts(self, verdicts: Mapping[PortRef, PortVerdict]) -> None:
        self.view.scene().set_verdicts(verdicts if self.timeline.moment is None else {})

    def _mark(self, found: Difference) -> None:
        """Mark a change, unless it is that of everything."""
        count = len(self._monitor.snapshot.nodelets)
        if self.timeline.moment is None and len(found.came | found.went) <= max(
            _MARKED, count / 2
        ):
            self.view.scene().marks.show(found)

    def show_timeline(self, on: bool) -> None:
        self.timeline.setVisible(on)
        (self.timeline.track if on else self.view).setFocus()

    def state(self) -> dict[str, str]:
        """The settings to save, as texts."""
        return {**self.bar.state(), "places": self.edits.places.to_text()}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore settings; missing or invalid ones are ignored."""
        self.edits.places.read(str(state.get("places", "")))
        self.bar.restore(state)

    def _turn(self) -> None:
        """Fill a view that has another shape now, with streams along its longer side."""
        room = self.view.viewport().size()
        change = self._shape / self._order.shape
        is_turned = self._order.figure.is_downwards != self.bar.is_downwards(room)
        is_left = self.view.is_chosen or bool(self.edits.places.present)
        if is_turned or not (is_left or 1 / _RESHAPED < change < _RESHAPED):
            self.tidy()

    @property
    def _shape(self) -> float:
        """That of the view: width by height."""
        return float(self.view.width() / max(self.view.height(), 1))

    def find(self) -> None:
        self.bar.search.setFocus()
        self.bar.search.selectAll()

    def _follow_drawing(self, drawing: Drawing) -> None:
        self._selection.keep_drawn(drawing.figure)
        self._follow_selection()
        if drawing.figure.vertices and (not self._has_fitted or drawing.is_anew):
            self._has_fitted = True
            self.view.fit()
        self.view.keep_in_view()
        self._search()

    def _show_sign(self) -> None:
        monitor, text = self._monitor, ""
        status = monitor.heart.status
        if not status.is_sound:
            text = status.text
        elif not self._snapshot.nodelets:
            text = "No nodelets yet: make one in 'Create', or ask for a stream in 'Streams'"
            if not monitor.library:
                text = "No nodelets and no transformations yet: import some in 'Library'"
        elif not self._order.figure.vertices:
            text = "The filters hide everything"
        is_over_drawing = bool(self._snapshot.nodelets)
        self.sign.show_text(text, is_warning=is_over_drawing and not status.is_sound)

    # Menus and selection

    def _show_menu(self, item: Item | None, place: QPoint) -> None:
        """Show the menu of a port, of the background, or of the selection with the item."""
        snapshot, edits = self._monitor.snapshot, self.edits
        if not self.view.is_editable:
            self._line.note("this is the past; press End in the time-line to change the present")
            return
        if isinstance(item, PortItem):
            self._popup(menu_of_port(item.ref, snapshot, edits, self), place)
        elif item is None:
            spot = self.view.mapToScene(self.view.viewport().mapFromGlobal(place))
            box = self.view.scene().box_at(spot)
            outer = [group for group in self._order.figure.groups() if len(group) == 1]
            self._popup(menu_of_ground(edits, self.bar, box, outer), place)
        else:
            if item.key not in self._selection.keys:
                self.view.select(item)
            self.show_menu(place)

    def show_menu(self, place: QPoint) -> None:
        menu = menu_of(self._selection, self._monitor, self.edits, self)
        self._popup(menu, place)

    def _popup(self, menu: QMenu, place: QPoint) -> None:
        menu.setAttribute(Qt.WA_DeleteOnClose)
        menu.popup(place)

    def _take_selection(self) -> None:
        """Take the selection that the user, not a change of the drawing, has selected in it."""
        if not (self._is_following or self.view.scene().slices.is_working):
            scene = self.view.scene()
            chosen = [key for key, item in scene.things.items() if item.isSelected()]
            self._selection.choose(chosen)

    def _follow_selection(self) -> None:
        wanted = self._selected_items()
        self._is_following = True
        for item in wanted.symmetric_difference(self.view.scene().selectedItems()):
            item.setSelected(item in wanted)
        self._is_following = False

    def _selected_items(self) -> set[Item]:
        """The items of the selection, a collapsed box for those in it."""
        keys, things = self._selection.keys, self.view.scene().things
        boxes = {box.key for box in self.drawn.vertices if not keys.isdisjoint(box.members)}
        return {item for key, item in things.items() if key in keys | boxes}

    def _search(self) -> None:
        text = self.bar.search.text()
        hits = self.view.scene().find(text)
        self.bar.show_hits(f"{len(hits)} found" if text else "")

    def _next_hit(self) -> None:
        """Select the next item that was found, and show it."""
        hits = self.view.scene().find(self.bar.search.text())
        if hits:
            chosen = [number for number, item in enumerate(hits) if item.isSelected()]
            number = (chosen[0] + 1) % len(hits) if chosen else 0
            self.view.select(hits[number])
            self.view.reveal([hits[number]])
            self.bar.show_hits(f"{number + 1} of {len(hits)}")

    def reveal_selection(self) -> None:
        """Show where in the graph the selection is."""
        found = self._selected_items()
        self.view.reveal(found)
        if self._selection.keys and not found:
            self._line.note("nothing of the selection is drawn: see Filter and View")

    def _set_highlights(self, on: bool) -> None:
        self.view.scene().highlights = on

    # Inside

    def _grey(self) -> None:
        scene = self.view.scene()
        scene.set_palette(self.view.palette(), not self._monitor.is_linked)
        scene.show_past(self.timeline.moment is not None)

    def eventFilter(self, watched: object, event: QEvent) -> bool:  # noqa: N802
        """Follow changes of the view's palette."""
        if event.type() == QEvent.PaletteChange:
            self._grey()
            self._show_sign()
        return False

    def _listen(self) -> None:
        monitor, view, bar = self._monitor, self.view, self.bar
        monitor.changed.connect(self.redraw)
        monitor.measured.connect(self._show_traffic)
        self.timeline.changed.connect(self._mark)
        self.timeline.wanted.connect(self._show_moment)
        monitor.decided.connect(self._show_verdicts)
        view.scene().transports_wanted.connect(self._ask_transports)
        monitor.heart.told.connect(self._show_sign)
        monitor.heart.linked.connect(self._grey)
        monitor.library_changed.connect(self._show_sign)
        monitor.history_changed.connect(bar.show_history)
        view.scene().selectionChanged.connect(self._take_selection)
        self._selection.changed.connect(self._follow_selection)
        self.layouter.ready.connect(view.scene().show_drawing)
        view.scene().shown.connect(self._follow_drawing)
        self.layouter.failed.connect(self._line.report)
        self.edits.moved.connect(self.redraw)
        view.box_pressed.connect(bar.toggle_box)
        for follow in (self._show_sign, self.card.place, self._turning.start):
            view.resized.connect(follow)
        view.topic_pressed.connect(self.card.show_topic)
        view.menu_wanted.connect(self._show_menu)
        bar.options_changed.connect(self.redraw)
        bar.structure_changed.connect(self.tidy)
        bar.settings["highlight"].toggled.connect(self._set_highlights)
        for read in (monitor.read_library, monitor.look):
            bar.refresh.triggered.connect(read)
        bar.undo.triggered.connect(monitor.undo)
        bar.redo.triggered.connect(monitor.redo)
        bar.fit.triggered.connect(view.fit)
        bar.tidy.triggered.connect(self.tidy_all)
        bar.timeline.triggered.connect(self.show_timeline)
        bar.find.triggered.connect(self.find)
        bar.find_next.triggered.connect(self._next_hit)
        bar.search.textChanged.connect(self._search)
        bar.search.returnPressed.connect(self._next_hit)
        for edit in (bar.nodelets, bar.topics):
            edit.refused.connect(self._line.report)
            edit.mended.connect(self._line.withdraw)
        self.edits.topic_wanted.connect(self.card.show_topic)

    def _ask_transports(self, nodes: frozenset[str]) -> None:
        scene, remote = self.view.scene(), self._monitor.remote
        self._monitor.ask(
            lambda client: remote.transports(nodes), scene.set_transports, lambda why: None
        )
