# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shows ways to make a stream as trees."""

from __future__ import annotations

from typing import Any, List, Optional, Tuple

from python_qt_binding.QtCore import Signal
from python_qt_binding.QtGui import QGuiApplication, QKeySequence
from python_qt_binding.QtWidgets import QHeaderView, QTreeWidget, QTreeWidgetItem, QWidget

from dyknow_rqt.background_calls import qt_slot
from dyknow_rqt.graph.ways import Way


class WayTree(QTreeWidget):
    """Ways with their parts; the first is unfolded. Nothing is wrapped."""

    #: The user selected a part: the names of its nodelet, or none.
    picked = Signal(object)

    def __init__(self, name: str, parent: Optional[QWidget] = None) -> None:
        super().__init__(parent)
        self.ways: Tuple[Way, ...] = ()
        self.setHeaderLabels(("Part", "Cost", "How", "Bindings"))
        self.header().setSectionResizeMode(QHeaderView.ResizeToContents)
        self.setUniformRowHeights(True)
        self.setIndentation(14)
        self.setAlternatingRowColors(True)
        self.setAccessibleName(name)
        self.itemSelectionChanged.connect(self._pick)

    @property
    def text(self) -> str:
        """All of it, as it is copied: a line for each part."""
        parts = (part for way in self.ways for part in way)
        return "\n".join("  " * part.depth + "  ".join(filter(None, part.cells)) for part in parts)

    def show_ways(self, *ways: Way) -> None:
        if ways == self.ways:
            return
        self.ways = ways
        self.clear()
        for way in filter(None, ways):
            path: List[Any] = [self]
            for part in way:
                del path[part.depth + 1 :]
                item = QTreeWidgetItem(path[-1], part.cells)
                path.append(item)
                for column, cell in enumerate(part.cells):
                    item.setToolTip(column, cell)
        self.expandAll()
        for number in range(1, self.topLevelItemCount()):
            self.topLevelItem(number).setExpanded(False)

    @qt_slot
    def keyPressEvent(self, event: Any) -> None:  # noqa: N802
        if event.matches(QKeySequence.Copy):
            QGuiApplication.clipboard().setText(self.text)
        else:
            super().keyPressEvent(event)

    @qt_slot
    def _pick(self) -> None:
        names = [item.text(2).partition(" as ")[2] for item in self.selectedItems()]
        self.picked.emit([name for name in names if name])
