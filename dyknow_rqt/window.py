# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The whole window: control panel on the left, graph on the right, one line at the bottom."""

from __future__ import annotations

import contextlib
import gc
from typing import Any

from python_qt_binding.QtCore import QEvent, QSize, Qt, QTimer
from python_qt_binding.QtGui import QKeySequence, QPalette
from python_qt_binding.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QLineEdit,
    QSplitter,
    QTabWidget,
    QWidget,
)

from dyknow_rqt.canvas.appearance import colours_of
from dyknow_rqt.graph.health import Ill
from dyknow_rqt.graph_panel.panel import GraphPanel
from dyknow_rqt.monitoring.monitor import GraphMonitor
from dyknow_rqt.monitoring.remote import Remote
from dyknow_rqt.panels.connect import ConnectPanel
from dyknow_rqt.panels.create import CreatePanel
from dyknow_rqt.panels.lists import ActivePanel, LibraryPanel
from dyknow_rqt.panels.streams import StreamsPanel
from dyknow_rqt.selection import Selection
from dyknow_rqt.status_line import HealthLabel, StatusLine
from dyknow_rqt.widgets import KeysDialog, bare_column_in

#: Pixels: a window that is less wide than high and than this is narrow. The control panel is shown
#: in a narrow one that is higher than the second, and in another that is wider than the first.
_NARROW, _SMALL = 800, 560
#: Shares of the parts, from the left or from the top.
_SHARES = {int(Qt.Horizontal): [300, 700], int(Qt.Vertical): [600, 400]}
#: Pixels that the control panel has at least, and that its pages need.
_LEAST_PANEL, _PAGE = (160, 120), 390
#: A docked widget that is smaller shows no graph.
_LEAST = QSize(480, 320)


class DyKnowWidget(QWidget):
    """The widget that rqt docks and that the window on its own contains.

    It owns the monitor; ``shut_down`` ends it.
    """

    def __init__(self, remote: Remote) -> None:
        super().__init__()
        self.setObjectName("DyKnow")
        self.setWindowTitle("DyKnow")
        self.monitor = GraphMonitor(remote)
        self.line = StatusLine()
        self.health = HealthLabel(self.monitor)
        self.line.show_beside(self.health)
        self.selection = Selection(self.monitor)
        self._is_chosen = False
        self.graph = GraphPanel(self.monitor, self.selection, self.line)
        self.active = ActivePanel(self.monitor, self.line, self.selection, self.graph.edits)
        self.library = LibraryPanel(self.monitor, self.line)
        self.create_ = CreatePanel(self.monitor, self.line)
        self.connect_ = ConnectPanel(self.monitor, self.line)
        self.streams = StreamsPanel(self.monitor, self.line, self.selection)
        self.tabs = QTabWidget()
        self.tabs.setAccessibleName("Control panel")
        self.tabs.tabBar().setAccessibleName("Tabs of the control panel")
        for title, panel in (
            ("&Active", self.active),
            ("Li&brary", self.library),
            ("&Create", self.create_),
            ("C&onnect", self.connect_),
            ("&Streams", self.streams),
        ):
            self.tabs.addTab(panel, title)
        self.parts = QSplitter(Qt.Horizontal)
        self.parts.addWidget(self.tabs)
        self.parts.addWidget(self.graph)
        self.parts.setChildrenCollapsible(False)
        self._shares = dict(_SHARES)
        self.parts.setSizes(_SHARES[Qt.Horizontal])
        self.tabs.setMinimumSize(*_LEAST_PANEL)
        bare_column_in(self, self.parts, self.line).setStretch(0, 1)
        self._listen()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Layout of a small graph beside the control panel."""
        return QSize(1200, 760)

    def resizeEvent(self, event: QEvent) -> None:  # noqa: N802
        """Put the control panel below the graph in a narrow window, and away in a small one."""
        super().resizeEvent(event)
        size = event.size()
        self.tabs.setMinimumWidth(_PAGE if size.width() >= _NARROW else _LEAST_PANEL[0])
        is_narrow = size.width() < _NARROW and size.width() < size.height()
        if is_narrow is not (self.parts.orientation() == Qt.Vertical):
            self.parts.setOrientation(Qt.Vertical if is_narrow else Qt.Horizontal)
            self.parts.insertWidget(int(is_narrow), self.tabs)
            self.parts.setSizes(self._shares[self.parts.orientation()])
        if not self._is_chosen:
            is_room = size.height() >= _SMALL if is_narrow else size.width() >= _NARROW
            self._show_panel(is_room)

    def _choose_panel(self, on: bool) -> None:
        self._is_chosen = True
        self._show_panel(on)

    def _show_panel(self, on: bool) -> None:
        self.graph.bar.panel.setChecked(on)
        self.tabs.setVisible(on)

    def _show_tab(self, panel: QWidget) -> None:
        """Show a tab of the control panel, which may be away."""
        self._choose_panel(True)
        self.tabs.setCurrentWidget(panel)

    def start(self) -> None:
        self.monitor.start()

    def shut_down(self) -> None:
        """End everything that the widget started; returns at once."""
        with contextlib.suppress(TypeError):  # it was shut down before
            QApplication.instance().focusChanged.disconnect(self._follow_focus)
        self.monitor.close()
        self.graph.close_down()

    def state(self) -> dict[str, str]:
        """The settings to save, as texts."""
        parts = int(self.parts.orientation()), *self.parts.sizes()
        return {
            **self.graph.state(),
            "tab": str(self.tabs.currentIndex()),
            "parts": ",".join(map(str, parts)),
            "panel": str(int(self.graph.bar.panel.isChecked())) if self._is_chosen else "",
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore settings; missing and invalid ones are ignored."""
        state = {name: value for name, value in state.items() if value is not None}
        self.graph.restore(state)
        tab = str(state.get("tab", ""))
        if tab.isdecimal() and int(tab) < self.tabs.count():
            self.tabs.setCurrentIndex(int(tab))
        parts = [int(part) for part in str(state.get("parts", "")).split(",") if part.isdecimal()]
        if len(parts) == 3 and all(parts) and parts[0] in _SHARES:
            self._shares[parts[0]] = parts[1:]
            self.parts.setSizes(self._shares[self.parts.orientation()])
        if state.get("panel") in ("0", "1"):
            self._choose_panel(state["panel"] == "1")

    def _listen(self) -> None:
        QApplication.instance().focusChanged.connect(self._follow_focus)
        for field in self.streams.fields:  # committed: undo in it does not go back beyond this
            field.returnPressed.connect(lambda field=field: field.setText(field.text()))
        self.tabs.tabBar().installEventFilter(self)
        self.monitor.failed.connect(self.line.report)
        self.monitor.begun.connect(self.line.begin)
        self.monitor.done.connect(self.line.note)
        self.line.show_status(self.monitor.heart.status)
        self.monitor.heart.told.connect(self.line.show_status)
        self.monitor.heart.linked.connect(self._grey)
        self.graph.bar.panel.triggered.connect(self._choose_panel)
        self.active.menu_wanted.connect(self.graph.show_menu)
        for table in (self.active.table, self.streams.table, self.streams.plan):
            table.picked.connect(self.graph.reveal_selection)
        self.health.wanted.connect(self._lead_to)
        self.graph.bar.next_ill.triggered.connect(lambda: self.health.lead(""))
        self.streams.planned.connect(self.graph.show_plan)
        self.library.create_wanted.connect(self._begin_create)
        self.addActions([*self.graph.bar.actions_with_keys, self.line.decline])
        self.graph.bar.keys.triggered.connect(lambda: KeysDialog(self).open())
        actions = self.graph.edits
        actions.create_wanted.connect(self._begin_create)
        actions.connection_wanted.connect(self._begin_connection)

    def _follow_focus(self, before: QWidget | None, now: QWidget | None) -> None:
        if before is not None and _line_of(before) is not None:
            before.removeEventFilter(self)
        if now is not None and _line_of(now) is not None and self.isAncestorOf(now):
            now.installEventFilter(self)

    def eventFilter(self, watched: object, event: QEvent) -> bool:  # noqa: N802
        """Leave Undo and Redo to the graph where a field has nothing to undo itself.

        The key of the tab Streams leads into its first field.
        """
        if event.type() == QEvent.Shortcut:
            QTimer.singleShot(0, self._begin_tab)
        line = _line_of(watched) if event.type() == QEvent.ShortcutOverride else None
        if line is None:
            return False
        is_undo, is_redo = event.matches(QKeySequence.Undo), event.matches(QKeySequence.Redo)
        is_own = line.isUndoAvailable() if is_undo else line.isRedoAvailable()
        if is_own or not (is_undo or is_redo):
            return False
        event.ignore()
        return True

    def keyPressEvent(self, event: Any) -> None:  # noqa: N802
        button = self.focusWidget()
        if event.key() in (Qt.Key_Return, Qt.Key_Enter) and isinstance(button, QAbstractButton):
            button.click()
        else:
            super().keyPressEvent(event)

    def changeEvent(self, event: Any) -> None:  # noqa: N802
        super().changeEvent(event)
        if event.type() == QEvent.PaletteChange:
            self._grey()

    def _grey(self) -> None:
        """Grey the panels while their contents may be stale."""
        palette = QPalette()  # unset colours are inherited
        if not self.monitor.is_linked:
            muted = colours_of(self.palette()).muted
            for role in (QPalette.Text, QPalette.WindowText, QPalette.ButtonText):
                palette.setColor(role, muted)
        self.tabs.setPalette(palette)

    def _begin_tab(self) -> None:
        if self.tabs.currentWidget() is self.streams:
            self.streams.tag.setFocus()

    def _lead_to(self, ill: Ill) -> None:
        if ill.claim:
            self._show_tab(self.streams)
            self.streams.choose([ill.claim])
        else:
            self.selection.choose_nodelets([ill.nodelet])
        self.graph.reveal_selection()

    def _begin_create(self, label: str) -> None:
        self._show_tab(self.create_)
        self.create_.begin(label)

    def _begin_connection(self, nodelet: str, port: str) -> None:
        self._show_tab(self.connect_)
        self.connect_.begin(nodelet, port)


def _line_of(widget: object) -> QLineEdit | None:
    """The line that is edited in a field, a spin box or a combo box; None if there is none."""
    if isinstance(widget, (QAbstractSpinBox, QComboBox)):
        widget = widget.findChild(QLineEdit)
    return widget if isinstance(widget, QLineEdit) else None


def spare_imports() -> None:
    """Freeze imported objects out of the GC: a full collection pauses the window for 0.1 s."""
    gc.collect()
    gc.freeze()


def make_room(widget: QWidget) -> None:
    """Enlarge the window that a widget is docked in if next to nothing of it can be seen.

    rqt's own is as small as it can be when it is opened for the first time.
    """
    window = widget.window()
    if widget.width() >= _LEAST.width() and widget.height() >= _LEAST.height():
        return
    more = widget.sizeHint() - widget.size()
    screen = QApplication.desktop().availableGeometry(window).size()
    wanted = window.size() + QSize(max(0, more.width()), max(0, more.height()))
    window.resize(wanted.boundedTo(screen))
