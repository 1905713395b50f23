# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tab Active: the nodelets that run."""

from __future__ import annotations

from typing import Sequence

from python_qt_binding.QtCore import QPoint, Qt, Signal
from python_qt_binding.QtWidgets import QPushButton

from dyknow.model.graph import NodeletKind, State
from dyknow.model.transformation import IN
from dyknow_rqt.background_calls import qt_slot
from dyknow_rqt.graph.changes import destroy, protect
from dyknow_rqt.graph.snapshot import Snapshot, not_destroyed, protection
from dyknow_rqt.monitor import GraphMonitor
from dyknow_rqt.panels.tables import KeyedTable, Panel
from dyknow_rqt.selection import Selection
from dyknow_rqt.status_line import StatusLine
from dyknow_rqt.widgets import column_in, row_of

#: The most nodelets that are named in a question; of more, only the tool tip has the names.
_NAMED = 5
_TITLES = ("Nodelet", "Transformation", "In", "Out", "State", "Manager")


class ActivePanel(Panel):
    """Lists nodelets; destroys and protects them."""

    #: A context menu of the selection is wanted, at this place on the screen.
    menu_wanted = Signal(QPoint)

    def __init__(self, monitor: GraphMonitor, line: StatusLine, selection: Selection) -> None:
        super().__init__(monitor, line)
        self._selection = selection
        self.table = KeyedTable(_TITLES, "Active nodelets")
        self.table.setContextMenuPolicy(Qt.CustomContextMenu)
        self.destroy = QPushButton("Des&troy …", clicked=self._destroy_chosen)
        self.protect = QPushButton("&Protect", clicked=self._protect_chosen)
        row = row_of(self.protect, self.destroy)
        row.insertStretch(0, 1)
        column_in(self, self.table.filter, self.table, row)
        self.table.picked.connect(selection.choose_nodelets)
        self.table.customContextMenuRequested.connect(self._want_menu)
        selection.changed.connect(self._follow_selection)
        monitor.changed.connect(self._show)
        self.table.on_delete(self._destroy_chosen)
        self._follow_selection()

    @qt_slot
    def ask_to_destroy(self, names: Sequence[str]) -> None:
        why_not = not_destroyed(names, self._monitor.snapshot)
        if why_not:
            self._line.report(why_not)
            return
        changes = [destroy(name) for name in names]
        question = f"Destroy {', '.join(names)}?"
        if len(names) > _NAMED:
            question = "\n".join([f"Destroy {len(names)} nodelets?", *names])
        self._line.ask(question, "Destroy", lambda: self._do_in_turn(changes))

    @qt_slot
    def _destroy_chosen(self) -> None:
        if self._selection.nodelets:
            self.ask_to_destroy(self._selection.nodelets)

    @qt_slot
    def _protect_chosen(self) -> None:
        self.set_protection(*protection(self._selection.nodelets, self._monitor.snapshot))

    @qt_slot
    def set_protection(self, names: Sequence[str], on: bool) -> None:
        self._do_in_turn([protect(name, on) for name in names])

    @qt_slot
    def _want_menu(self, place: QPoint) -> None:
        self.menu_wanted.emit(self.table.viewport().mapToGlobal(place))

    @qt_slot
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

    @qt_slot
    def _follow_selection(self) -> None:
        names = self._selection.nodelets
        self.table.follow(names)
        why_not = not_destroyed(names, self._monitor.snapshot)
        self.destroy.setEnabled(bool(names) and not why_not)
        self.destroy.setToolTip(why_not or "Delete")
        self.protect.setEnabled(bool(names))
        _, on = protection(names, self._monitor.snapshot)
        self.protect.setText("&Protect" if on else "&Release")
