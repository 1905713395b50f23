# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Small widgets and layouts that several parts of the window share."""

from __future__ import annotations

import html
from typing import Iterable, List, Optional

from python_qt_binding.QtCore import QPoint, QRect, QSize, QStringListModel, Qt, Signal
from python_qt_binding.QtGui import QFont, QPalette
from python_qt_binding.QtWidgets import (
    QCompleter,
    QDialog,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLayout,
    QLayoutItem,
    QLineEdit,
    QPlainTextEdit,
    QWidget,
)

from dyknow_rqt.background_calls import qt_slot
from dyknow_rqt.canvas.appearance import colours_of
from dyknow_rqt.graph.filters import BadFilter, Filter, completions, parse


def row_of(*widgets: QWidget) -> QHBoxLayout:
    row = QHBoxLayout()
    for widget in widgets:
        row.addWidget(widget)
    return row


def form_in(parent: Optional[QWidget] = None) -> QFormLayout:
    """A form whose fields use all of the width."""
    form = QFormLayout(parent)
    form.setFieldGrowthPolicy(QFormLayout.AllNonFixedFieldsGrow)
    return form


def text_of(name: str) -> QPlainTextEdit:
    """A text in a monospace font that the user only reads."""
    text = QPlainTextEdit()
    text.setReadOnly(True)
    text.setTabChangesFocus(True)
    fixed = QFont("monospace", text.font().pointSize())
    fixed.setStyleHint(QFont.Monospace)
    text.setFont(fixed)
    text.setAccessibleName(name)
    return text


def wrapped(text: str) -> str:
    """The text of a tool tip whose lines are wrapped."""
    return f"<p style='white-space: pre-wrap'>{html.escape(text)}</p>" if text else ""


class FilterEdit(QLineEdit):
    """Keeps the last valid filter."""

    #: The filter has changed.
    filter_changed = Signal()
    #: The text is not a filter: the reason.
    refused = Signal(str)
    #: The text is a filter again: the reason that was given before.
    mended = Signal(str)

    def __init__(self, what: str, parent: Optional[QWidget] = None) -> None:
        super().__init__(parent)
        self.filter = Filter()
        self._names: List[str] = []
        self._complaint = ""
        self.setPlaceholderText(f"all {what}")
        self.setClearButtonEnabled(True)
        self.setAccessibleName(f"Filter of {what}")
        self.setToolTip(
            f"Which {what} to show: names, namespaces or regular expressions, separated by commas;"
            " a leading - excludes.\nExample: /robot, /cam.*, -/robot/debug"
        )
        self._model = QStringListModel(self)
        completer = QCompleter(self._model, self)
        completer.setCompletionMode(QCompleter.PopupCompletion)
        completer.setCaseSensitivity(Qt.CaseSensitive)
        self.setCompleter(completer)
        self.textEdited.connect(self._offer)
        self.textChanged.connect(self._read)

    def set_names(self, names: Iterable[str]) -> None:
        self._names = sorted(names)

    @qt_slot
    def _offer(self, text: str) -> None:
        self._model.setStringList(completions(text, self._names))

    @qt_slot
    def _read(self, text: str) -> None:
        palette = QPalette(self.parentWidget().palette()) if self.parentWidget() else QPalette()
        try:
            self.filter = parse(text)
        except BadFilter as error:
            palette.setColor(QPalette.Text, colours_of(palette).alarm)
            self._complaint = str(error)
            self.refused.emit(self._complaint)
        else:
            complaint, self._complaint = self._complaint, ""
            if complaint:
                self.mended.emit(complaint)
            self.filter_changed.emit()
        self.setPalette(palette)


_SPACING = (12, 3)


class FlowLayout(QLayout):
    """Widgets side by side, in as many lines as they need.

    Widgets that can grow share the rest of their line, in proportion to their size.
    """

    def __init__(self, parent: Optional[QWidget] = None) -> None:
        super().__init__(parent)
        self._items: List[QLayoutItem] = []

    def addItem(self, item: QLayoutItem) -> None:  # noqa: N802
        self._items.append(item)

    def count(self) -> int:
        return len(self._items)

    def itemAt(self, index: int) -> Optional[QLayoutItem]:  # noqa: N802
        return self._items[index] if 0 <= index < len(self._items) else None

    def takeAt(self, index: int) -> Optional[QLayoutItem]:  # noqa: N802
        return self._items.pop(index) if 0 <= index < len(self._items) else None

    def hasHeightForWidth(self) -> bool:  # noqa: N802
        return True

    def heightForWidth(self, width: int) -> int:  # noqa: N802
        return self._arrange(QRect(0, 0, width, 0), moving=False)

    def setGeometry(self, area: QRect) -> None:  # noqa: N802
        super().setGeometry(area)
        self._arrange(area, moving=True)

    def sizeHint(self) -> QSize:  # noqa: N802
        return self.minimumSize()

    def minimumSize(self) -> QSize:  # noqa: N802
        left, top, right, bottom = self.getContentsMargins()
        size = QSize()
        for item in filter(lambda item: not item.isEmpty(), self._items):
            size = size.expandedTo(item.minimumSize())
        return size + QSize(left + right, top + bottom)

    def _arrange(self, area: QRect, moving: bool) -> int:
        """Fill line after line; returns the height."""
        left, top, right, bottom = self.getContentsMargins()
        width, y = area.width() - left - right, area.y() + top
        for line in self._lines(width):
            height = max(item.sizeHint().height() for item in line)
            if moving:
                self._fill(line, QPoint(area.x() + left, y), width, height)
            y += height + _SPACING[1]
        return int(y - _SPACING[1] + bottom - area.y())

    def _lines(self, width: int) -> List[List[QLayoutItem]]:
        lines: List[List[QLayoutItem]] = []
        used = 0
        for item in self._items:
            if item.isEmpty():
                continue  # hidden
            wish = item.sizeHint().width()
            if not lines or used + _SPACING[0] + wish > width:
                lines.append([item])
                used = wish
            else:
                lines[-1].append(item)
                used += _SPACING[0] + wish
        return lines

    @staticmethod
    def _fill(line: List[QLayoutItem], start: QPoint, width: int, height: int) -> None:
        wishes = [min(item.sizeHint().width(), width) for item in line]
        growing = [bool(item.expandingDirections() & Qt.Horizontal) for item in line]
        spare = max(0, width - sum(wishes) - _SPACING[0] * (len(line) - 1))
        total = sum(wish for wish, grows in zip(wishes, growing) if grows)
        x = start.x()
        for item, wish, grows in zip(line, wishes, growing):
            size = wish + (spare * wish // total if grows else 0)
            item.setGeometry(QRect(x, start.y(), size, height))
            x += size + _SPACING[0]


class Sign(QLabel):
    """Shows a hint on empty ground, or a warning in a band that is read on any drawing."""

    def __init__(self, ground: QWidget) -> None:
        super().__init__(ground)
        self._ground = ground
        self.setAlignment(Qt.AlignCenter)
        self.setWordWrap(True)
        self.setMargin(8)
        # Else the roles are those of the ground.
        self.setBackgroundRole(QPalette.Window)
        self.setForegroundRole(QPalette.WindowText)
        self.setAttribute(Qt.WA_TransparentForMouseEvents)
        self.setAccessibleName("State of the graph")

    def show_text(self, text: str, is_warning: bool) -> None:
        self.setText(f"⚠ {text}" if is_warning else text)
        self.setVisible(bool(text))
        palette = QPalette(self._ground.palette())
        if is_warning:
            colours = colours_of(palette)
            palette.setColor(QPalette.Window, colours.alarm)
            palette.setColor(QPalette.WindowText, colours.paper)
        self.setPalette(palette)
        self.setAutoFillBackground(is_warning)
        width = self._ground.width()
        self.setGeometry(0, 0, width, self.heightForWidth(width) if is_warning else 160)


#: The keys and their actions.
KEYS = (
    ("F5, Ctrl+R", "read everything now"),
    ("Ctrl+0", "fit everything into the view"),
    ("Ctrl+L", "tidy: make a new layout"),
    ("Ctrl+F, F3", "find; the next one"),
    ("F9", "show or hide the control panel"),
    ("Ctrl+Z", "undo; Ctrl+Shift+Z or Ctrl+Y redo"),
    ("arrows", "select the next thing in that direction; with Ctrl move the view"),
    ("+, -, wheel", "zoom"),
    ("Delete", "disconnect, or destroy; in the tables: destroy, delete or release"),
    ("Return", "press the button that has the focus"),
    ("Esc", "decline what the line at the bottom asks, or dismiss it; end a connection"),
    ("menu key", "the context menu of the selection"),
    ("Shift+?, F1", "this list"),
)


class KeysDialog(QDialog):
    """Lists the keys."""

    def __init__(self, parent: Optional[QWidget] = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Keys")
        form = QFormLayout(self)
        form.setHorizontalSpacing(24)
        for keys, what in KEYS:
            text = QLabel(what)
            text.setWordWrap(True)
            text.setMinimumWidth(300)
            form.addRow(QLabel(f"<b>{keys}</b>"), text)
