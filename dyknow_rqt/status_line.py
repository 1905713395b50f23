# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The line at the bottom of the window: results, errors, questions, health, contact."""

from __future__ import annotations

import contextlib
import logging
import sys
import traceback
import weakref
from collections import Counter
from functools import partial
from types import TracebackType
from typing import Any, Callable

from python_qt_binding.QtCore import QEvent, Qt, QTimer, Signal
from python_qt_binding.QtGui import QKeySequence, QPalette
from python_qt_binding.QtWidgets import (
    QAction,
    QApplication,
    QLabel,
    QPushButton,
    QSizePolicy,
    QWidget,
)

from dyknow.errors import DyKnowError
from dyknow_rqt.canvas.appearance import colours_of
from dyknow_rqt.graph.filters import BadFilter
from dyknow_rqt.graph.health import Ill, Status, ills_of
from dyknow_rqt.monitoring.monitor import GraphMonitor
from dyknow_rqt.widgets import row_of, wrapped

_LOG = logging.getLogger("rosout.dyknow_rqt")
_NOTE_TIME = 6000  # ms
#: Those of the windows of this process.
_LINES: weakref.WeakSet[StatusLine] = weakref.WeakSet()


def _survive(
    before: Callable[..., object],
    kind: type[BaseException],
    error: BaseException,
    trace: TracebackType | None,
) -> None:
    """Show an error that has left a slot; without a hook PyQt aborts the process, be it rqt.

    Expected errors are shown in their own words, others with their type, and logged. Those of
    other parts of this process, and those that end it, are left to the hook before this one.
    """
    frames = [frame for frame, _ in traceback.walk_tb(trace)]
    is_ours = any(f.f_globals.get("__name__", "").startswith("dyknow_rqt.") for f in frames)
    is_end = not frames or frames[0].f_code.co_name == "<module>"
    if is_end or not is_ours or not isinstance(error, Exception):
        before(kind, error, trace)
        return
    text = str(error)
    if not isinstance(error, (DyKnowError, BadFilter, OSError)):
        _LOG.error("not caught", exc_info=(kind, error, trace))
        text = f"{kind.__name__} in {frames[0].f_code.co_name}: {error}"
    for line in list(_LINES):
        with contextlib.suppress(RuntimeError):  # Qt has taken the window apart
            line.report(text)


class StatusLine(QWidget):
    """Shows errors until they are dismissed or something succeeds, without dialogs.

    Also those that leave a slot of the window.
    """

    def __init__(self) -> None:
        super().__init__()
        _LINES.add(self)
        sys.excepthook = partial(_survive, sys.excepthook)
        self._text = QLabel(wordWrap=True, textFormat=Qt.PlainText, accessibleName="Message")
        self._text.setTextInteractionFlags(Qt.TextSelectableByMouse | Qt.TextSelectableByKeyboard)
        self._text.setSizePolicy(QSizePolicy.Ignored, QSizePolicy.Preferred)
        self.contact = QLabel(textFormat=Qt.PlainText, accessibleName="Contact with the manager")
        self.contact.setMinimumWidth(1)  # or a long text would keep the window wide
        self.yes = QPushButton(clicked=self._confirm)
        self.no = QPushButton("Cancel", clicked=self.clear)
        self.dismiss = QPushButton("Dismiss", clicked=self.clear)
        row = row_of(self._text, self.yes, self.no, self.dismiss, self.contact)
        row.setContentsMargins(6, 2, 6, 2)
        row.setStretch(0, 1)
        self.setLayout(row)
        #: Declines the question of the line, or dismisses its message; works in the whole window.
        self.decline = QAction(self, shortcut=QKeySequence(Qt.Key_Escape), triggered=self.clear)
        self.decline.setShortcutContext(Qt.WidgetWithChildrenShortcut)
        self._asked_in: QWidget | None = None
        self._full = ""
        self._status: Status | None = None
        self._answer: Callable[[], None] | None = None
        self._timer = QTimer(self, interval=_NOTE_TIME, singleShot=True, timeout=self.clear)
        self.clear()

    def show_beside(self, widget: QWidget) -> None:
        """Show a widget before the contact to the manager."""
        self.layout().insertWidget(self.layout().count() - 1, widget)

    @property
    def text(self) -> str:
        return str(self._text.text())

    def report(self, text: str) -> None:
        """Show an error: its first line in the window, all of it in the tool tip."""
        self._show(text)
        self.dismiss.show()
        self._colour()
        self.decline.setEnabled(True)

    def withdraw(self, text: str) -> None:
        """Remove an error that no longer holds, if the line still shows it."""
        if self._full == text:
            self.clear()

    def begin(self, text: str) -> None:
        if self._answer is None:
            self._show(text)

    def note(self, text: str) -> None:
        if self._answer is None:
            self._show(text)
            self._timer.start()

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
        self._show(question)
        self._answer, self._asked_in = answer, QApplication.focusWidget()
        self.decline.setEnabled(True)
        self.yes.setText(yes)
        self.yes.show()
        self.no.show()
        self.yes.setFocus()

    def changeEvent(self, event: Any) -> None:  # noqa: N802
        super().changeEvent(event)
        if event.type() == QEvent.PaletteChange and self._status is not None:
            self.show_status(self._status)
            self._colour()

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
        self._colour()
        self.contact.show()

    def _confirm(self) -> None:
        answer = self._answer
        self.clear()
        if answer is not None:
            answer()

    def _show(self, text: str) -> None:
        self.clear()
        lines = text.strip().split("\n")
        more = f"  (and {len(lines) - 1} more lines: rest the pointer here)" if lines[1:] else ""
        self._text.setText(lines[0] + more)
        self._full = text
        self._text.setToolTip(wrapped(text))
        self.contact.hide()

    def _colour(self) -> None:
        """Write errors, which alone are dismissed, in their colour."""
        palette = QPalette(self.palette())
        if not self.dismiss.isHidden():
            palette.setColor(QPalette.WindowText, colours_of(palette).alarm)
        self._text.setPalette(palette)


class HealthLabel(QLabel):
    """Such as ``3 lost, 1 degraded, 2 slow``; each word is a link to the next of its kind."""

    #: Show an ``Ill``.
    wanted = Signal(object)

    def __init__(self, monitor: GraphMonitor) -> None:
        super().__init__()
        self._monitor = monitor
        self._ills: list[Ill] = []
        self._last: Ill | None = None
        self.setTextInteractionFlags(Qt.LinksAccessibleByMouse | Qt.LinksAccessibleByKeyboard)
        self.setAccessibleName("What is not well")
        self.linkActivated.connect(self.lead)
        changes = (monitor.changed, monitor.streams_changed, monitor.measured)
        for signal in (*changes, monitor.heart.linked):
            signal.connect(self._look)
        self.hide()

    def lead(self, word: str) -> None:
        """Lead to the next one of a word, or the next one at all."""
        ills = [ill for ill in self._ills if word in ("", ill.word)]
        if ills:
            number = ills.index(self._last) + 1 if self._last in ills else 0
            self._last = ills[number % len(ills)]
            self.wanted.emit(self._last)

    def changeEvent(self, event: QEvent) -> None:  # noqa: N802
        super().changeEvent(event)
        if event.type() == QEvent.PaletteChange:
            self._show()

    def _look(self) -> None:
        """Show nothing while it may be old."""
        monitor, ills = self._monitor, []
        if monitor.is_linked:
            ills = ills_of(monitor.snapshot, monitor.streams, monitor.traffic)
        if ills != self._ills:
            self._ills = ills
            self._show()

    def _show(self) -> None:
        colour = colours_of(self.palette()).alarm.name()
        counts = Counter(ill.word for ill in self._ills)  # in their order
        links = (f"<a href='{w}' style='color: {colour}'>{n} {w}</a>" for w, n in counts.items())
        text = ", ".join(links)
        if text != self.text():
            self.setText(text)
        self.setToolTip(wrapped("\n".join(f"{ill.word}: {ill.title}" for ill in self._ills)))
        self.setVisible(bool(self._ills))
