# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A field for a filter of names, with completion and a sign for errors."""

from __future__ import annotations

from typing import Iterable, List, Optional

from python_qt_binding.QtCore import QStringListModel, Qt, Signal
from python_qt_binding.QtGui import QPalette
from python_qt_binding.QtWidgets import QCompleter, QLineEdit, QWidget

from dyknow_rqt.canvas.colours import colours_of
from dyknow_rqt.graph.filters import BadFilter, Filter, completions, parse
from dyknow_rqt.qt_slot import qt_slot


class FilterEdit(QLineEdit):
    """Keeps the last valid filter."""

    #: The filter has changed.
    filter_changed = Signal()
    #: The text is no filter: the reason.
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
        """Set the names that are completed."""
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
