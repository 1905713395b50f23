# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Tables and trees of the panels, and what all panels share."""

from __future__ import annotations

import contextlib
from typing import Any, Callable, Iterable, Iterator, Sequence, Tuple

from python_qt_binding.QtCore import (
    QAbstractTableModel,
    QEvent,
    QItemSelection,
    QModelIndex,
    QSignalBlocker,
    Qt,
    Signal,
)
from python_qt_binding.QtGui import QGuiApplication, QKeySequence
from python_qt_binding.QtWidgets import (
    QAbstractItemView,
    QAbstractSpinBox,
    QAction,
    QComboBox,
    QHeaderView,
    QScrollArea,
    QTableView,
    QTreeWidget,
    QTreeWidgetItem,
    QWidget,
)

from dyknow_rqt.graph.ways import Way
from dyknow_rqt.monitoring.monitor import GraphMonitor
from dyknow_rqt.status_line import StatusLine
from dyknow_rqt.widgets import field_of, wrapped


class Panel(QScrollArea):
    """A tab of the control panel: makes changes by the monitor, and asks in the status line.

    Its page scrolls where there is too little room.
    """

    def __init__(self, monitor: GraphMonitor, line: StatusLine) -> None:
        super().__init__(widgetResizable=True, focusPolicy=Qt.NoFocus)
        self._monitor, self._line, self.page = monitor, line, QWidget()
        self.setFrameShape(self.NoFrame)
        self.setWidget(self.page)
        for ground in (self.viewport(), self.page):
            ground.setAutoFillBackground(False)  # that of the tab is seen

    def showEvent(self, event: Any) -> None:  # noqa: N802
        super().showEvent(event)
        for box in self.page.findChildren((QComboBox, QAbstractSpinBox)):
            box.setFocusPolicy(Qt.StrongFocus)  # by the wheel it gets none
            box.installEventFilter(self)

    def eventFilter(self, watched: Any, event: QEvent) -> bool:  # noqa: N802
        """Let the wheel scroll the page over a box that is not being edited."""
        if event.type() == QEvent.Wheel and watched is not self.page and not watched.hasFocus():
            self.wheelEvent(event)
            return True
        return bool(super().eventFilter(watched, event))


#: The number of rows that determine the width of columns.
_SAMPLED = 40
#: The most pixels that the first columns take.
_WIDEST = (160, 115)
#: The cells of a row, and its tool tip.
Row = Tuple[Tuple[str, ...], str]


class _Rows(QAbstractTableModel):
    """Sorts and filters its rows itself: a proxy model would call Python for each comparison."""

    def __init__(self, titles: Sequence[str], table: KeyedTable) -> None:
        super().__init__(table)
        self._titles, self._table = titles, table
        self.all: list[Row] = []
        self.shown: list[Row] = []
        self.places: dict[str, int] = {}
        self._column, self._backwards, self._filter = 0, False, ""

    def replace(self, rows: Sequence[Row]) -> None:
        """Replace the rows; where only cells differ, the view lays out nothing again."""
        before, self.all = self.shown, list(rows)
        found = self._arranged()
        if [row[0][0] for row in found] != [row[0][0] for row in before]:
            self._arrange()
            return
        self.shown = found
        for place, (now, then) in enumerate(zip(found, before)):
            if now != then:
                last = self.index(place, len(self._titles) - 1)
                self.dataChanged.emit(self.index(place, 0), last)

    def set_filter(self, text: str) -> None:
        self._filter = text.lower()
        self._arrange()

    def sort(self, column: int, order: int = Qt.AscendingOrder) -> None:
        """Sort by a column; numbers as numbers."""
        self._column, self._backwards = column, order == Qt.DescendingOrder
        self._arrange()

    def rowCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: B008, N802
        return 0 if parent.isValid() else len(self.shown)

    def columnCount(self, parent: QModelIndex = QModelIndex()) -> int:  # noqa: B008, N802
        return len(self._titles)

    def data(self, index: QModelIndex, role: int = Qt.DisplayRole) -> Any:
        if role not in (Qt.DisplayRole, Qt.ToolTipRole):
            return None
        cells, more = self.shown[index.row()]
        text = cells[index.column()]
        if role == Qt.DisplayRole:
            return text
        return wrapped("\n".join(part for part in (text, more) if part))

    def headerData(  # noqa: N802
        self, section: int, orientation: int, role: int = Qt.DisplayRole
    ) -> Any:
        if role == Qt.DisplayRole and orientation == Qt.Horizontal:
            return self._titles[section]
        return None

    def _arrange(self) -> None:
        with self._table.selection_kept():
            self.beginResetModel()
            self.shown = self._arranged()
            self.places = {row[0][0]: place for place, row in enumerate(self.shown)}
            self.endResetModel()

    def _arranged(self) -> list[Row]:
        def key(row: Row) -> tuple[bool, int | str, str]:
            cell = row[0][self._column]
            return (False, int(cell), row[0][0]) if cell.isdecimal() else (True, cell, row[0][0])

        wanted = self._filter
        rows = [row for row in self.all if any(wanted in cell.lower() for cell in row[0])]
        return sorted(rows, key=key, reverse=self._backwards)


class KeyedTable(QTableView):
    """A table whose rows have their first cell as key."""

    #: The user selected other rows: their keys.
    picked = Signal(object)

    def __init__(self, titles: Sequence[str], name: str) -> None:
        super().__init__()
        self._rows = _Rows(titles, self)
        self._widths: dict[int, int] = {}  # of columns, as they were set last
        self.setModel(self._rows)
        self.setSelectionBehavior(QAbstractItemView.SelectRows)
        self.setSelectionMode(QAbstractItemView.ExtendedSelection)
        self.setHorizontalScrollMode(QAbstractItemView.ScrollPerPixel)
        self.setTabKeyNavigation(False)
        self.setShowGrid(False)
        self.setWordWrap(False)
        self.setTextElideMode(Qt.ElideMiddle)  # names often differ at their ends
        self.setAlternatingRowColors(True)
        self.setAccessibleName(name)
        #: Shows only rows with a cell that contains its text; the panel places it.
        what = f"{name[0].lower()}{name[1:]}"
        self.filter = field_of(f"filter {what}", name=f"Filter of {what}")
        self.filter.setClearButtonEnabled(True)
        self.filter.textChanged.connect(self._rows.set_filter)
        self.verticalHeader().hide()
        self.verticalHeader().setDefaultSectionSize(self.fontMetrics().height() + 8)
        header = self.horizontalHeader()
        header.setHighlightSections(False)
        header.setMinimumSectionSize(24)
        header.setResizeContentsPrecision(_SAMPLED)
        header.setDefaultAlignment(Qt.AlignLeft | Qt.AlignVCenter)
        for column in range(len(_WIDEST), len(titles)):
            header.setSectionResizeMode(column, QHeaderView.ResizeToContents)
        header.setSortIndicator(0, Qt.AscendingOrder)
        self.setSortingEnabled(True)

    def event(self, event: QEvent) -> bool:
        """Handle an event; in Python, so that cells are queried without a wait for each."""
        return bool(super().event(event))

    def viewportEvent(self, event: QEvent) -> bool:  # noqa: N802
        """Paint; in Python for the same reason."""
        return bool(super().viewportEvent(event))

    def on_delete(self, function: Callable[[], None]) -> None:
        action = QAction(self, shortcut=QKeySequence(Qt.Key_Delete), triggered=function)
        action.setShortcutContext(Qt.WidgetShortcut)
        self.addAction(action)

    def show_rows(self, rows: Sequence[Row]) -> None:
        """Replace the rows; selection and scroll position stay."""
        if list(rows) == self._rows.all:
            return
        top = self.verticalScrollBar().value()
        self._rows.replace(rows)
        if rows:
            self._widen()
        self.verticalScrollBar().setValue(top)

    @contextlib.contextmanager
    def selection_kept(self) -> Iterator[None]:
        """Select the same keys after a change of the rows, as far as they are shown then."""
        chosen, index = self.chosen(), self.currentIndex()
        current = self._name(index.row()) if index.isValid() else None
        with QSignalBlocker(self):
            yield
            self.choose(chosen, current)

    def _widen(self) -> None:
        """Make room for the first columns, except those that a hand has made wider or narrower."""
        for column, widest in enumerate(_WIDEST):
            before = self._widths.get(column)
            if before in (None, self.columnWidth(column)):
                contents = min(widest, self.sizeHintForColumn(column) + 12)
                least = before or self.horizontalHeader().sectionSizeHint(column)
                self._widths[column] = max(contents, least)
                self.setColumnWidth(column, self._widths[column])

    def chosen(self) -> list[str]:
        rows = sorted(index.row() for index in self.selectionModel().selectedRows())
        return [self._name(row) for row in rows]

    def names(self) -> list[str]:
        return [row[0][0] for row in self._rows.shown]

    def choose(self, names: Iterable[str], current: str | None = None) -> None:
        """Select the rows of these keys only, and make one the current row."""
        selection = self.selectionModel()
        places = [self._rows.places[name] for name in names if name in self._rows.places]
        if current in self._rows.places:
            places_of_current = [self._rows.places[str(current)]]
        else:
            places_of_current = places[:1]
        for place in places_of_current:
            selection.setCurrentIndex(self._rows.index(place, 0), selection.NoUpdate)
        chosen = QItemSelection()
        for place in places:
            index = self._rows.index(place, 0)
            chosen.select(index, index)
        selection.select(chosen, selection.ClearAndSelect | selection.Rows)

    def follow(self, names: Iterable[str]) -> None:
        """Select the rows of these keys only, as the user has done elsewhere."""
        if self._rows.places.keys() & names != set(self.chosen()):
            with QSignalBlocker(self):
                self.choose(names)
            if self.chosen():
                self.scrollTo(self.selectionModel().selectedRows()[0])

    def selectionChanged(self, now: QItemSelection, before: QItemSelection) -> None:  # noqa: N802
        """Tell which rows are selected."""
        super().selectionChanged(now, before)
        self.picked.emit(self.chosen())

    def _name(self, row: int) -> str:
        return self._rows.shown[row][0][0]


class WayTree(QTreeWidget):
    """Ways with their parts; the first is unfolded. Nothing is wrapped."""

    #: The user selected a part: the names of its nodelet, or none.
    picked = Signal(object)

    def __init__(self, name: str) -> None:
        super().__init__()
        self.ways: tuple[Way, ...] = ()
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
        with QSignalBlocker(self):  # the user has not selected anything else
            self.clear()
        for way in filter(None, ways):
            path: list[Any] = [self]
            for part in way:
                del path[part.depth + 1 :]
                item = QTreeWidgetItem(path[-1], part.cells)
                path.append(item)
                for column, cell in enumerate(part.cells):
                    item.setToolTip(column, cell)
        self.expandAll()
        for number in range(1, self.topLevelItemCount()):
            self.topLevelItem(number).setExpanded(False)

    def keyPressEvent(self, event: Any) -> None:  # noqa: N802
        if event.matches(QKeySequence.Copy):
            QGuiApplication.clipboard().setText(self.text)
        else:
            super().keyPressEvent(event)

    def _pick(self) -> None:
        names = [item.text(2).partition(" as ")[2] for item in self.selectedItems()]
        self.picked.emit([name for name in names if name])
