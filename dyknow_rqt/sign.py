# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A message over the upper edge of the drawing."""

from __future__ import annotations

from python_qt_binding.QtCore import Qt
from python_qt_binding.QtGui import QPalette
from python_qt_binding.QtWidgets import QLabel, QWidget

from dyknow_rqt.canvas.colours import colours_of


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
        """Show a text, or nothing if it is empty."""
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
