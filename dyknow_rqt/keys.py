# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The keys of the window, and the list of them."""

from __future__ import annotations

from typing import Optional

from python_qt_binding.QtWidgets import QDialog, QFormLayout, QLabel, QWidget

#: Keys, and what they do.
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
