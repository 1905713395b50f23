# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tabs Active and Library: the nodelets that run, and the transformations."""

from __future__ import annotations

from typing import Mapping

from python_qt_binding.QtCore import QPoint, Qt, Signal
from python_qt_binding.QtWidgets import QFileDialog, QPushButton, QSplitter

from dyknow.errors import DyKnowError
from dyknow.model.graph import NodeletKind, State
from dyknow.model.transformation import IN, Transformation, as_specification
from dyknow_rqt.graph.changes import add_transformations, protect, remove_transformations
from dyknow_rqt.graph.snapshot import Snapshot, not_destroyed, protection
from dyknow_rqt.graph_panel.edits import GraphEdits
from dyknow_rqt.monitoring.monitor import GraphMonitor
from dyknow_rqt.panels.tables import KeyedTable, Panel
from dyknow_rqt.selection import Selection
from dyknow_rqt.status_line import StatusLine
from dyknow_rqt.widgets import column_in, row_of, text_of

_TITLES = ("Nodelet", "Transformation", "In", "Out", "State", "Manager")


class ActivePanel(Panel):
    """Lists nodelets; destroys and protects them."""

    #: A context menu of the selection is wanted, at this place on the screen.
    menu_wanted = Signal(QPoint)

    def __init__(
        self, monitor: GraphMonitor, line: StatusLine, selection: Selection, edits: GraphEdits
    ) -> None:
        super().__init__(monitor, line)
        self._selection, self._edits = selection, edits
        self.table = KeyedTable(_TITLES, "Active nodelets")
        self.table.setContextMenuPolicy(Qt.CustomContextMenu)
        self.destroy = QPushButton("Des&troy …", clicked=self._destroy_chosen)
        self.protect = QPushButton("&Protect", clicked=self._protect_chosen)
        row = row_of(self.protect, self.destroy)
        row.insertStretch(0, 1)
        column_in(self.page, self.table.filter, self.table, row)
        self.table.picked.connect(selection.choose_nodelets)
        self.table.customContextMenuRequested.connect(self._want_menu)
        for signal in (selection.changed, self.table.filter.textChanged):
            signal.connect(self._follow_selection)
        monitor.changed.connect(self._show)
        self.table.on_delete(self._destroy_chosen)
        self._follow_selection()

    def _destroy_chosen(self) -> None:
        if self._selection.nodelets:
            self._edits.ask_to_destroy(self._selection.nodelets)

    def _protect_chosen(self) -> None:
        names, on = protection(self._selection.nodelets, self._monitor.snapshot)
        self._monitor.do_in_turn([protect(name, on) for name in names])

    def _want_menu(self, place: QPoint) -> None:
        self.menu_wanted.emit(self.table.viewport().mapToGlobal(place))

    def _show(self, snapshot: Snapshot) -> None:
        rows = []
        for nodelet in snapshot.nodelets:
            inputs = sum(port.direction == IN for port in nodelet.ports)
            words = [nodelet.state.name.lower()] if nodelet.state is not State.RUNNING else []
            words += ["outdated"] if nodelet.outdated else []
            words += ["protected"] if nodelet.is_protected else []
            words += [] if nodelet.kind is NodeletKind.PYTHON else [nodelet.kind.title]
            cells = (
                nodelet.name,
                nodelet.origin,
                str(inputs),
                str(len(nodelet.ports) - inputs),
                ", ".join(words) or "running",
                nodelet.manager or "(a process of its own)",
            )
            rows.append((cells, nodelet.detail))
        self.table.show_rows(rows)
        self._follow_selection()

    def _follow_selection(self) -> None:
        names = self._selection.nodelets
        self.table.follow(names)
        why_not = not_destroyed(names, self._monitor.snapshot)
        self.destroy.setEnabled(bool(names) and not why_not)
        self.destroy.setToolTip(why_not or "Delete")
        self.protect.setEnabled(bool(names))
        _, on = protection(names, self._monitor.snapshot)
        self.protect.setText("&Protect" if on else "&Release")


_FILES = "Specifications (*.xml);;All files (*)"


class LibraryPanel(Panel):
    """Transformations by label; imports, exports and deletes them."""

    #: A nodelet is to be made from a transformation: its label.
    create_wanted = Signal(str)

    def __init__(self, monitor: GraphMonitor, line: StatusLine) -> None:
        super().__init__(monitor, line)
        self.table = KeyedTable(("Label", "Source", "In", "Out", "Cost"), "Transformations")
        self.specification = text_of("Specification")
        self.import_ = QPushButton("&Import …", clicked=self._ask_what_to_import)
        self.export = QPushButton("E&xport …", clicked=self._ask_where_to_export)
        self.delete = QPushButton("Delete …", clicked=self._ask_to_delete)
        self.create = QPushButton("Ne&w nodelet …", clicked=self._want_create)
        parts = QSplitter(Qt.Vertical)
        parts.addWidget(self.table)
        parts.addWidget(self.specification)
        parts.setStretchFactor(0, 3)
        parts.setStretchFactor(1, 2)
        buttons = row_of(self.import_, self.export, self.delete, self.create)
        column_in(self.page, self.table.filter, parts, buttons).setStretch(1, 1)
        monitor.library_changed.connect(self._show)
        for signal in (self.table.picked, self.table.filter.textChanged):
            signal.connect(self._follow_selection)
        self.table.on_delete(self._ask_to_delete)
        self.table.activated.connect(self._want_create)
        self._follow_selection()

    def import_file(self, path: str) -> None:
        try:
            with open(path, encoding="utf-8") as file:
                text = file.read()
        except UnicodeDecodeError as error:
            raise DyKnowError(f"{path}: is not UTF-8; expected XML in UTF-8") from error
        self._monitor.do(add_transformations(text, path.rpartition("/")[2]))

    def export_file(self, path: str) -> None:
        chosen = [self._monitor.library[label] for label in self.table.chosen()]
        with open(path, "w", encoding="utf-8") as file:
            file.write(as_specification(chosen))
        self._line.note(f"{len(chosen)} transformations written to {path}")

    def _ask_what_to_import(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Import transformations", "", _FILES)
        if path:
            self.import_file(path)

    def _ask_where_to_export(self) -> None:
        name = "transformations.xml"
        path, _ = QFileDialog.getSaveFileName(self, "Export transformations", name, _FILES)
        if path:
            self.export_file(path)

    def _ask_to_delete(self) -> None:
        labels = self.table.chosen()
        if labels:
            change = remove_transformations(labels)
            question = f"{change.text[0].upper()}{change.text[1:]} from the library?"
            self._line.ask(question, "Delete", lambda: self._monitor.do(change))

    def _want_create(self) -> None:
        for label in self.table.chosen()[:1]:
            self.create_wanted.emit(label)

    def _show(self, library: Mapping[str, Transformation]) -> None:
        rows = []
        for label in sorted(library):
            each = library[label]
            inputs = sum(port.direction == IN for port in each.ports)
            source = f"{each.type} " * each.is_described + (each.node or each.source)
            cells = (label, source, str(inputs), str(len(each.ports) - inputs), str(each.cost))
            rows.append((cells, ""))
        self.table.show_rows(rows)
        self._follow_selection()

    def _follow_selection(self) -> None:
        labels = self.table.chosen()
        library = self._monitor.library
        shown = [library[label] for label in labels[:20] if label in library]
        text = "\n".join(each.to_xml() for each in shown)
        if text != self.specification.toPlainText():
            self.specification.setPlainText(text)
        for button in (self.export, self.delete):
            button.setEnabled(bool(labels))
        spawnable = len(shown) == 1 and not shown[0].is_described
        self.create.setEnabled(spawnable)
