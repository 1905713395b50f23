# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The line at the bottom of the window: results, errors, questions, contact to the manager."""

from __future__ import annotations

import contextlib
from typing import Any, Callable, List, Optional

from python_qt_binding.QtCore import QEvent, Qt, QTimer
from python_qt_binding.QtGui import QKeySequence, QPalette
from python_qt_binding.QtWidgets import (
    QAction,
    QApplication,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QSizePolicy,
    QWidget,
)

from dyknow_rqt.background_calls import qt_slot
from dyknow_rqt.canvas.appearance import colours_of
from dyknow_rqt.graph.contact import Status
from dyknow_rqt.widgets import wrapped

_NOTE_TIME = 6000  # ms
_KEPT = 50


class StatusLine(QWidget):
    """Shows errors until they are dismissed or something succeeds, without dialogs."""

    def __init__(self, parent: Optional[QWidget] = None) -> None:
        super().__init__(parent)
        self.history: List[str] = []
        self._text = QLabel()
        self._text.setTextInteractionFlags(Qt.TextSelectableByMouse | Qt.TextSelectableByKeyboard)
        self._text.setSizePolicy(QSizePolicy.Ignored, QSizePolicy.Preferred)
        self._text.setWordWrap(True)
        self._text.setAccessibleName("Message")
        self._text.setTextFormat(Qt.PlainText)
        self.contact = QLabel()
        self.contact.setAccessibleName("Contact with the manager")
        self.contact.setTextFormat(Qt.PlainText)
        self.yes = QPushButton()
        self.no = QPushButton("Cancel")
        self.dismiss = QPushButton("Dismiss")
        row = QHBoxLayout(self)
        row.setContentsMargins(6, 2, 6, 2)
        row.addWidget(self._text, 1)
        for button in (self.yes, self.no, self.dismiss):
            row.addWidget(button)
        row.addWidget(self.contact)
        #: Declines the question of the line, or dismisses its message; works in the whole window.
        self.decline = QAction(self)
        self.decline.setShortcut(QKeySequence(Qt.Key_Escape))
        self.decline.setShortcutContext(Qt.WidgetWithChildrenShortcut)
        self.decline.triggered.connect(self.clear)
        self._asked_in: Optional[QWidget] = None
        self._full = ""
        self._status: Optional[Status] = None
        self._answer: Optional[Callable[[], None]] = None
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.timeout.connect(self.clear)
        self.yes.clicked.connect(self._confirm)
        self.no.clicked.connect(self.clear)
        self.dismiss.clicked.connect(self.clear)
        self.clear()

    def show_beside(self, widget: QWidget) -> None:
        """Show a widget before the contact to the manager."""
        self.layout().insertWidget(self.layout().count() - 1, widget)

    @property
    def text(self) -> str:
        return str(self._text.text())

    def report(self, text: str) -> None:
        """Show an error: its first line in the window, all of it in the tool tip."""
        self._show(text, alarm=True)
        self.dismiss.show()
        self.decline.setEnabled(True)

    def withdraw(self, text: str) -> None:
        """Remove an error that no longer holds, if the line still shows it."""
        if self._full == text:
            self.clear()

    def begin(self, text: str) -> None:
        if self._answer is None:
            self._show(text, alarm=False)

    def note(self, text: str) -> None:
        if self._answer is None:
            self._show(text, alarm=False)
            self._timer.start(_NOTE_TIME)

    @qt_slot
    def show_status(self, status: Status) -> None:
        self._status = status
        self.contact.setText(status.short if status.is_sound else f"⚠ {status.short}")
        self.contact.setToolTip(status.text)
        colours = colours_of(self.palette())
        palette = QPalette(self.palette())
        palette.setColor(QPalette.WindowText, colours.muted if status.is_sound else colours.alarm)
        self.contact.setPalette(palette)

    def ask(self, question: str, yes: str, answer: Callable[[], None]) -> None:
        """Ask something; ``answer`` is called if the user agrees."""
        self._show(question, alarm=False)
        self._answer, self._asked_in = answer, QApplication.focusWidget()
        self.decline.setEnabled(True)
        self.yes.setText(yes)
        self.yes.show()
        self.no.show()
        self.yes.setFocus()

    @qt_slot
    def changeEvent(self, event: Any) -> None:  # noqa: N802
        super().changeEvent(event)
        if event.type() == QEvent.PaletteChange and self._status is not None:
            self.show_status(self._status)

    @qt_slot
    def clear(self) -> None:
        """Empty the line; the focus returns to where it was before a question."""
        if self._asked_in is not None and (self.yes.hasFocus() or self.no.hasFocus()):
            with contextlib.suppress(RuntimeError):  # it has been deleted
                self._asked_in.setFocus()
        self._answer = self._asked_in = None
        self._timer.stop()
        self._full = ""
        self._text.setText("")
        self._text.setToolTip("")
        self.decline.setEnabled(False)
        for button in (self.yes, self.no, self.dismiss):
            button.hide()

    @qt_slot
    def _confirm(self) -> None:
        answer = self._answer
        self.clear()
        if answer is not None:
            answer()

    def _show(self, text: str, alarm: bool) -> None:
        self.clear()
        lines = text.strip().split("\n")
        more = f"  (and {len(lines) - 1} more lines: rest the pointer here)" if lines[1:] else ""
        self._text.setText(lines[0] + more)
        self._full = text
        self._text.setToolTip(wrapped(text))
        palette = QPalette(self.palette())
        if alarm:
            palette.setColor(QPalette.WindowText, colours_of(self.palette()).alarm)
        self._text.setPalette(palette)
        self.history = [*self.history[-_KEPT:], text]
