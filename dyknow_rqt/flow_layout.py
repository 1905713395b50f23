# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A layout that wraps into lines, as text does, so that a window can be narrow."""

from __future__ import annotations

from typing import List, Optional

from python_qt_binding.QtCore import QPoint, QRect, QSize, Qt
from python_qt_binding.QtWidgets import QLayout, QLayoutItem, QWidget

_SPACING = (12, 3)


class FlowLayout(QLayout):
    """Widgets side by side, in as many lines as they need.

    Widgets that can grow share the rest of their line, in proportion to their size.
    """

    def __init__(self, parent: Optional[QWidget] = None) -> None:
        super().__init__(parent)
        self._items: List[QLayoutItem] = []

    def addItem(self, item: QLayoutItem) -> None:  # noqa: N802
        """Add an item."""
        self._items.append(item)

    def count(self) -> int:
        """The number of items."""
        return len(self._items)

    def itemAt(self, index: int) -> Optional[QLayoutItem]:  # noqa: N802
        """Return an item, or None."""
        return self._items[index] if 0 <= index < len(self._items) else None

    def takeAt(self, index: int) -> Optional[QLayoutItem]:  # noqa: N802
        """Remove an item and return it."""
        return self._items.pop(index) if 0 <= index < len(self._items) else None

    def hasHeightForWidth(self) -> bool:  # noqa: N802
        """The height depends on the width."""
        return True

    def heightForWidth(self, width: int) -> int:  # noqa: N802
        """The height for a width."""
        return self._arrange(QRect(0, 0, width, 0), moving=False)

    def setGeometry(self, area: QRect) -> None:  # noqa: N802
        """Place the items."""
        super().setGeometry(area)
        self._arrange(area, moving=True)

    def sizeHint(self) -> QSize:  # noqa: N802
        """The same as the minimum."""
        return self.minimumSize()

    def minimumSize(self) -> QSize:  # noqa: N802
        """The widest of them, and the margins."""
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
