# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tab Library: the transformations."""

from __future__ import annotations

from typing import Mapping

from python_qt_binding.QtCore import Qt, Signal
from python_qt_binding.QtWidgets import QFileDialog, QPushButton, QSplitter

from dyknow.model.transformation import IN, Transformation, as_specification
from dyknow_rqt.background_calls import qt_slot
from dyknow_rqt.graph.changes import add_transformations, remove_transformations
from dyknow_rqt.monitor import GraphMonitor
from dyknow_rqt.panels.tables import KeyedTable, Panel
from dyknow_rqt.status_line import StatusLine
from dyknow_rqt.widgets import column_in, row_of, text_of

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
        column_in(self, self.table.filter, parts, buttons).setStretch(1, 1)
        monitor.library_changed.connect(self._show)
        self.table.selectionModel().selectionChanged.connect(self._follow_selection)
        self.table.on_delete(self._ask_to_delete)
        self.table.activated.connect(self._want_create)
        self._follow_selection()

    def import_file(self, path: str) -> None:
        with open(path, encoding="utf-8", errors="strict") as file:
            text = file.read()
        self._monitor.do(add_transformations(text, path.rpartition("/")[2]))

    def export_file(self, path: str) -> None:
        chosen = [self._monitor.library[label] for label in self.table.chosen()]
        with open(path, "w", encoding="utf-8") as file:
            file.write(as_specification(chosen))
        self._line.note(f"{len(chosen)} transformations written to {path}")

    @qt_slot
    def _ask_what_to_import(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Import transformations", "", _FILES)
        if path:
            self.import_file(path)

    @qt_slot
    def _ask_where_to_export(self) -> None:
        name = "transformations.xml"
        path, _ = QFileDialog.getSaveFileName(self, "Export transformations", name, _FILES)
        if path:
            self.export_file(path)

    @qt_slot
    def _ask_to_delete(self) -> None:
        labels = self.table.chosen()
        if labels:
            change = remove_transformations(labels)
            question = f"{change.text[0].upper()}{change.text[1:]} from the library?"
            self._line.ask(question, "Delete", lambda: self._monitor.do(change))

    @qt_slot
    def _want_create(self) -> None:
        for label in self.table.chosen()[:1]:
            self.create_wanted.emit(label)

    @qt_slot
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

    @qt_slot
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
