"""Tables that keep selection and place when their contents change."""

from __future__ import annotations

from typing import Any, List, Optional, Sequence, Tuple

from python_qt_binding.QtCore import QAbstractTableModel, QModelIndex, QSortFilterProxyModel, Qt
from python_qt_binding.QtWidgets import QAbstractItemView, QHeaderView, QTableView, QWidget

#: Rows that decide how wide columns are; a library may have a hundred thousand.
_SAMPLED = 200
#: What a row shows, and what it tells when the pointer rests on it.
Row = Tuple[Tuple[str, ...], str]


class _Rows(QAbstractTableModel):
    def __init__(self, titles: Sequence[str], parent: QWidget) -> None:
        super().__init__(parent)
        self._titles = titles
        self.rows: List[Row] = []

    def replace(self, rows: Sequence[Row]) -> None:
        """Take other rows."""
        self.beginResetModel()
        self.rows = list(rows)
        self.endResetModel()

    def rowCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: B008, N802
        """Number of rows."""
        return 0 if parent.isValid() else len(self.rows)

    def columnCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: B008, N802
        """Number of columns."""
        return len(self._titles)

    def data(self, index: QModelIndex, role: int = Qt.DisplayRole) -> Any:
        """Text and tool tip of a cell."""
        cells, tip = self.rows[index.row()]
        if role == Qt.DisplayRole:
            text = cells[index.column()]
            return int(text) if text.isdigit() else text  # so that numbers sort as numbers
        return tip if role == Qt.ToolTipRole else None

    def headerData(  # noqa: N802
        self, section: int, orientation: int, role: int = Qt.DisplayRole
    ) -> Any:
        """Titles."""
        if role == Qt.DisplayRole and orientation == Qt.Horizontal:
            return self._titles[section]
        return None


class Table(QTableView):
    """Rows are known by their first cell."""

    def __init__(self, titles: Sequence[str], name: str, parent: Optional[QWidget] = None) -> None:
        super().__init__(parent)
        self._rows = _Rows(titles, self)
        self._sorted = QSortFilterProxyModel(self)
        self._sorted.setSourceModel(self._rows)
        self._sorted.setFilterCaseSensitivity(Qt.CaseInsensitive)
        self._sorted.setFilterKeyColumn(0)
        self.setModel(self._sorted)
        self.setSortingEnabled(True)
        self.sortByColumn(0, Qt.AscendingOrder)
        self.setSelectionBehavior(QAbstractItemView.SelectRows)
        self.setSelectionMode(QAbstractItemView.ExtendedSelection)
        self.setTabKeyNavigation(False)
        self.setShowGrid(False)
        self.setAlternatingRowColors(True)
        self.setAccessibleName(name)
        self.verticalHeader().hide()
        self.verticalHeader().setDefaultSectionSize(self.fontMetrics().height() + 8)
        self.horizontalHeader().setHighlightSections(False)
        self.horizontalHeader().setMinimumSectionSize(24)
        self.horizontalHeader().setResizeContentsPrecision(_SAMPLED)
        self.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeToContents)
        self.setHorizontalScrollMode(QAbstractItemView.ScrollPerPixel)

    def show_rows(self, rows: Sequence[Row]) -> None:
        """Show other rows; what is selected stays so, and nothing scrolls."""
        if list(rows) == self._rows.rows:
            return
        chosen, top = set(self.chosen()), self.verticalScrollBar().value()
        current = self._name(self.currentIndex().row()) if self.currentIndex().isValid() else None
        self._rows.replace(rows)
        self.choose(chosen, current)
        self.verticalScrollBar().setValue(top)

    def set_filter(self, text: str) -> None:
        """Show rows only whose first cell holds a text."""
        self._sorted.setFilterFixedString(text)

    def chosen(self) -> List[str]:
        """First cells of the rows that are selected, from top to bottom."""
        rows = sorted(index.row() for index in self.selectionModel().selectedRows())
        return [self._name(row) for row in rows]

    def names(self) -> List[str]:
        """First cells of all rows that are shown, from top to bottom."""
        return [self._name(row) for row in range(self._sorted.rowCount())]

    def choose(self, names: Any, current: Optional[str] = None) -> None:
        """Select rows, and make one the current."""
        wanted, selection = set(names), self.selectionModel()
        for row in range(self._sorted.rowCount()):
            index, name = self._sorted.index(row, 0), self._name(row)
            if name == current or (current is None and name in wanted):
                selection.setCurrentIndex(index, selection.NoUpdate)
            if name in wanted:
                selection.select(index, selection.Select | selection.Rows)

    def _name(self, row: int) -> str:
        return str(self._sorted.data(self._sorted.index(row, 0)))
