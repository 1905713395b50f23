# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Small widgets and layouts that several parts of the window share."""

from __future__ import annotations

import html
from typing import Iterable

from python_qt_binding.QtCore import QEvent, QStringListModel, Qt, Signal
from python_qt_binding.QtGui import QFont, QPalette
from python_qt_binding.QtWidgets import (
    QCompleter,
    QDialog,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLayout,
    QLineEdit,
    QPlainTextEdit,
    QVBoxLayout,
    QWidget,
)

from dyknow_rqt.canvas.appearance import colours_of
from dyknow_rqt.graph.filters import BadFilter, Filter, completions, parse


def row_of(*widgets: QWidget) -> QHBoxLayout:
    row = QHBoxLayout()
    for widget in widgets:
        row.addWidget(widget)
    return row


def column_in(parent: QWidget, *parts: object) -> QVBoxLayout:
    """A column of widgets and layouts."""
    column = QVBoxLayout(parent)
    for part in parts:
        add = column.addLayout if isinstance(part, QLayout) else column.addWidget
        add(part)
    return column


def bare_column_in(parent: QWidget, *parts: object) -> QVBoxLayout:
    """A column without room around and between its parts."""
    column = column_in(parent, *parts)
    column.setContentsMargins(0, 0, 0, 0)
    column.setSpacing(0)
    return column


def field_of(placeholder: str, tip: str = "", name: str = "") -> QLineEdit:
    """A line of text, with an example for it; a buddy makes up for the name."""
    return QLineEdit(placeholderText=placeholder, toolTip=tip, accessibleName=name)


def form_in(parent: QWidget | None = None) -> QFormLayout:
    """A form whose fields use all of the width."""
    form = QFormLayout(parent)
    form.setFieldGrowthPolicy(QFormLayout.AllNonFixedFieldsGrow)
    return form


def text_of(name: str) -> QPlainTextEdit:
    """A text in a monospace font that the user only reads."""
    text = QPlainTextEdit(readOnly=True, tabChangesFocus=True, accessibleName=name)
    fixed = QFont("monospace", text.font().pointSize())
    fixed.setStyleHint(QFont.Monospace)
    text.setFont(fixed)
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

    def __init__(self, what: str) -> None:
        super().__init__()
        self.filter = Filter()
        self._names: list[str] = []
        self._complaint = ""
        self.setPlaceholderText(f"all {what}")
        self.setClearButtonEnabled(True)
        self.setAccessibleName(f"Filter of {what}")
        self.setToolTip(
            f"Which {what} to show: names, namespaces or regular expressions, separated by commas;"
            " a leading - excludes.\nExample: /robot, /cam.*, -/robot/debug"
        )
        self._model = QStringListModel(self)
        self.setCompleter(QCompleter(self._model, self))
        self.textEdited.connect(self._offer)
        self.textChanged.connect(self._read)

    def set_names(self, names: Iterable[str]) -> None:
        self._names = sorted(names)

    def _offer(self, text: str) -> None:
        self._model.setStringList(completions(text, self._names))

    def _read(self, text: str) -> None:
        try:
            self.filter = parse(text)
        except BadFilter as error:
            self._complaint = str(error)
            self.refused.emit(self._complaint)
        else:
            complaint, self._complaint = self._complaint, ""
            if complaint:
                self.mended.emit(complaint)
            self.filter_changed.emit()
        self._colour()

    def changeEvent(self, event: QEvent) -> None:  # noqa: N802
        super().changeEvent(event)
        if event.type() == QEvent.PaletteChange:
            self._colour()

    def _colour(self) -> None:
        palette = QPalette(self.parentWidget().palette()) if self.parentWidget() else QPalette()
        if self._complaint:
            palette.setColor(QPalette.Text, colours_of(palette).alarm)
        self.setPalette(palette)


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
    ("F7", "show or hide the time-line; there arrows, Home and End choose a moment"),
    ("F8", "the next thing that is not well"),
    ("F9", "show or hide the control panel"),
    ("Ctrl+Z", "undo; Ctrl+Shift+Z or Ctrl+Y redo"),
    ("arrows", "select the next thing in that direction; with Ctrl move the view"),
    ("+, -, wheel", "zoom"),
    ("Delete", "disconnect, or destroy; in the tables: destroy, delete or release"),
    ("Return", "press the button that has the focus; in the graph show the last message"),
    ("Esc", "decline what the line asks, or dismiss it; end a connection, close a card"),
    ("menu key", "the context menu of the selection"),
    ("Shift+?, F1", "this list"),
)


class KeysDialog(QDialog):
    """Lists the keys."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setWindowTitle("Keys")
        self.setAttribute(Qt.WA_DeleteOnClose)
        form = QFormLayout(self)
        form.setHorizontalSpacing(24)
        for keys, what in KEYS:
            form.addRow(QLabel(f"<b>{keys}</b>"), QLabel(what))
