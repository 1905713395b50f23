# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The bar above the graph: its actions, and the options of the drawing."""

from __future__ import annotations

from typing import Any, Iterable

from python_qt_binding.QtCore import QByteArray, QEvent, QSize, Qt, QTimer, Signal
from python_qt_binding.QtGui import QIcon, QKeySequence, QPainter, QPalette, QPixmap
from python_qt_binding.QtSvg import QSvgRenderer
from python_qt_binding.QtWidgets import (
    QAction,
    QActionGroup,
    QLabel,
    QMenu,
    QToolBar,
    QToolButton,
    QWidget,
)

from dyknow_rqt.graph.figure import Boxes, Group, Options
from dyknow_rqt.graph.filters import Filter
from dyknow_rqt.widgets import FilterEdit, bare_column_in, field_of, row_of

_TYPING = 250  # ms
#: A view is narrow if it is so many times higher than wide.
_NARROW = 1.2
#: Options of which one holds: name, title, choices, and the one at the beginning.
_CHOICES = (
    ("mode", "&Draw", ("Nodelets/Topics", "Nodelets only"), 0),
    ("direction", "&Flow", ("Automatic", "To the right", "Downwards"), 0),
    ("boxes", "&Boxes", tuple(each.value.capitalize() for each in Boxes), 0),
    ("depth", "Boxes &within boxes", ("None", "1", "2", "3", "4", "5"), 2),
)
#: Options that hold or do not: name, title, tool tip, and whether it holds at the beginning.
_CHECKS = (
    ("dead_sinks", "Hide dead &sinks", "Topics without a receiver", False),
    ("leaf_topics", "Hide &leaf topics", "Topics with only one end", False),
    ("debug", "Hide &debug", "What is in every graph: /rosout, /clock, rviz, rqt …", True),
    ("nodes", "Show ROS &nodes", "Ordinary nodes that use these topics, greyed", False),
    ("highlight", "&Highlight", "The neighbours of the thing under the pointer", True),
)
_FILTERS = ("nodelets", "topics")
#: Pixels of a drawn icon; smaller ones are made from it.
_ICON = 96
_SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 24 24"><path d="{}" fill="none" '
    'stroke="{}" stroke-width="1.8" stroke-linecap="round" stroke-linejoin="round"/></svg>'
)
#: Lines in a square of 24, by the names of freedesktop.org or of common themes.
_LINES = {
    "configure": "M4 7H12M18 7H20M4 17H6M12 17H20M15 4V10M9 14V20",
    "distribute-graph-directed": "M3 9H9V15H3ZM15 3H21V9H15ZM15 15H21V21H15ZM9 11L15 6M9 13L15 18",
    "document-open": "M3 19V5H9L11 8H19V11M3 19L6 11H22L19 19Z",
    "document-save": "M12 3V14M7 9.5L12 14.5L17 9.5M4 15V20H20V15",
    "edit-redo": "M16 4L21 9L16 14M21 9H10C2 9 2 20 10 20H13",
    "edit-undo": "M8 4L3 9L8 14M3 9H14C22 9 22 20 14 20H11",
    "go-next": "M8 5L15 12L8 19",
    "view-filter": "M3 4H21L14 13V20L10 17V13Z",
    "view-history": "M12 3C24 3 24 21 12 21C0 21 0 3 12 3M12 8V12L15.5 14",
    "view-refresh": "M20 4V9H15M20 9C17 2 4 3 4 12C4 21 17 22 20 15",
    "view-sidetree": "M3 4H21V20H3ZM9 4V20M5 8H7M5 12H7",
    "zoom-fit-best": "M3 8V3H8M16 3H21V8M21 16V21H16M8 21H3V16M8 8H16V16H8Z",
}


class GraphBar(QWidget):
    """Edits the options; its state is a dictionary of texts.

    Buttons that have no room are in a menu at the end of the bar. Settings are actions of which
    each holds or not, and groups of which one holds; collapsed boxes are drawn as one vertex.
    """

    #: The options have changed.
    options_changed = Signal()
    #: They have changed so much that the old layout has no meaning.
    structure_changed = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.collapsed: frozenset[Group] = frozenset()
        self.tools = QToolBar()
        self.tools.setToolButtonStyle(Qt.ToolButtonTextUnderIcon)
        self._icons: dict[str, QAction] = {}
        self.panel = self._add("Pa&nel", "view-sidetree", "Show the control panel", "F9")
        self.panel.setCheckable(True)
        self.panel.setChecked(True)
        self.tools.addSeparator()
        self.undo = self._add("&Undo", "edit-undo", "", "Ctrl+Z")
        self.redo = self._add("Redo", "edit-redo", "", "Ctrl+Shift+Z", "Ctrl+Y")
        self.tools.addSeparator()
        self.fit = self._add("&Fit", "zoom-fit-best", "Fit everything into the view", "Ctrl+0")
        self.tidy = self._add("Tid&y", "distribute-graph-directed", "Make a new layout", "Ctrl+L")
        self.filter = self._add("Fi&lter", "view-filter", "Show only some nodelets and topics")
        self.filter.setCheckable(True)
        self.view = self._add("Vi&ew", "configure", "What is drawn, and how")
        self.view.setMenu(self._menu_of_options())
        self.tools.addSeparator()
        self.save = self._add("Sa&ve", "document-save", "Save the drawing, or the wiring")
        self.save_menu = QMenu(self)
        self.save.setMenu(self.save_menu)
        self.load = self._add("Loa&d", "document-open", "Load a wiring: nodelets, connections")
        self.timeline = self._add("Time", "view-history", "Show what changed when", "F7")
        self.timeline.setCheckable(True)
        self.refresh = self._add("Refres&h", "view-refresh", "Read everything now", "F5", "Ctrl+R")
        #: Not in the bar: these have keys, and are in the menu of the background.
        self.find = _with_keys(QAction("&Find …", self), "Ctrl+F")
        self.find_next = _with_keys(QAction("Find &next", self), "F3")
        self.keys = _with_keys(QAction("&Keys …", self), "Shift+?", "?", "F1")
        self.next_ill = _with_keys(QAction("Next that is not &well", self), "F8")
        self.search = field_of("find (Ctrl+F)", name="Find")
        self.search.setClearButtonEnabled(True)
        self.search.setFixedWidth(130)
        self.hits = QLabel()
        self.hits.hide()
        self.nodelets, self.topics = (FilterEdit(what) for what in _FILTERS)
        self._typing = QTimer(
            self, singleShot=True, interval=_TYPING, timeout=self.options_changed
        )
        self._arrange()
        self.show_history("", "")

    @property
    def actions_with_keys(self) -> list[QAction]:
        found = [action for action in self.tools.actions() if action.shortcuts()]
        return [*found, self.find, self.find_next, self.next_ill, self.keys]

    def is_downwards(self, view: QSize) -> bool:
        """Whether streams flow downwards in a view of that size."""
        is_narrow = bool(view.height() > _NARROW * view.width())
        return (is_narrow, False, True)[self.chosen("direction")]

    def options(self, view: QSize) -> Options:
        is_filtered = self.filter.isChecked()
        return Options(
            is_downwards=self.is_downwards(view),
            topics=self.chosen("mode") == 0,
            nodelet_filter=self.nodelets.filter if is_filtered else Filter(),
            topic_filter=self.topics.filter if is_filtered else Filter(),
            hide_dead_sinks=bool(self.chosen("dead_sinks")),
            hide_leaf_topics=bool(self.chosen("leaf_topics")),
            hide_debug=bool(self.chosen("debug")),
            show_nodes=bool(self.chosen("nodes")),
            boxes=list(Boxes)[self.chosen("boxes")],
            depth=self.chosen("depth"),
            collapsed=self.collapsed,
        )

    def chosen(self, name: str) -> int:
        """The number of the choice that holds, or whether an option does."""
        option = self.settings[name]
        if isinstance(option, QAction):
            return int(option.isChecked())
        return int(option.actions().index(option.checkedAction()))

    def choose(self, name: str, number: int) -> None:
        """Let a choice hold, by its number; an option holds with 1."""
        option = self.settings[name]
        action = option if isinstance(option, QAction) else option.actions()[number]
        if self.chosen(name) != number:
            action.trigger()

    def state(self) -> dict[str, str]:
        """The settings to save, as texts."""
        is_filtered = self.filter.isChecked()
        return {
            **{name: str(self.chosen(name)) for name in self.settings},
            **{name: getattr(self, name).text() if is_filtered else "" for name in _FILTERS},
            "collapsed": "\n".join(" ".join(group) for group in sorted(self.collapsed)),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore settings; missing or invalid ones are ignored."""
        for name, option in self.settings.items():
            count = 2 if isinstance(option, QAction) else len(option.actions())
            if state.get(name) in [str(number) for number in range(count)]:
                self.choose(name, int(state[name]))
        for name in _FILTERS:
            getattr(self, name).setText(str(state.get(name, "")))
        groups = str(state.get("collapsed", "")).splitlines()
        self.collapsed = frozenset(tuple(group.split()) for group in groups if group)

    def collapse(self, groups: Iterable[Group]) -> None:
        """Draw these boxes as one vertex each, and only these."""
        self.collapsed = frozenset(groups)
        self.structure_changed.emit()

    def toggle_box(self, group: Group) -> None:
        self.collapse(self.collapsed ^ {group})

    def show_history(self, undo: str, redo: str) -> None:
        for action, text in ((self.undo, undo), (self.redo, redo)):
            action.setEnabled(bool(text))
            _explain(action, f"{action.text().replace('&', '')}: {text or 'nothing'}")

    def show_hits(self, text: str) -> None:
        self.hits.setText(text)
        self.hits.setVisible(bool(text))

    def changeEvent(self, event: QEvent) -> None:  # noqa: N802
        super().changeEvent(event)
        if event.type() == QEvent.PaletteChange:
            self._draw_icons()

    def _add(self, text: str, icon: str, tip: str, *keys: str) -> QAction:
        """Add a button with a name; it takes the focus as other buttons do."""
        action = self._icons[icon] = self.tools.addAction(text)
        action.setIconText(text)  # with its letter
        _explain(_with_keys(action, *keys), tip)
        button = self.tools.widgetForAction(action)
        button.setFocusPolicy(Qt.TabFocus)
        button.setPopupMode(QToolButton.InstantPopup)
        return action

    def _menu_of_options(self) -> QMenu:
        menu = QMenu(self)
        menu.setToolTipsVisible(True)
        self.settings: dict[str, QAction | QActionGroup] = {}
        for name, title, texts, first in _CHOICES:
            group = self.settings[name] = QActionGroup(self)
            for text in texts:
                action = group.addAction(text)
                action.setCheckable(True)
            group.actions()[first].setChecked(True)
            group.triggered.connect(self.structure_changed)
            menu.addMenu(title).addActions(group.actions())
        menu.addSeparator()
        for name, title, tip, holds in _CHECKS:
            option = self.settings[name] = menu.addAction(title)
            option.setCheckable(True)
            option.setChecked(holds)
            option.setToolTip(tip)
            option.triggered.connect(self.options_changed)
        return menu

    def _arrange(self) -> None:
        self._more = self.tools.findChild(QToolButton, "qt_toolbar_ext_button")
        self._more.setFocusPolicy(Qt.TabFocus)
        self._more.setAccessibleName("More buttons")
        self._draw_icons()
        first, second = row_of(self.tools, self.hits, self.search), QWidget()
        first.setStretch(0, 1)
        second.setLayout(row_of(self.nodelets, self.topics))
        second.layout().setContentsMargins(4, 0, 4, 4)
        second.hide()
        bare_column_in(self, first, second).setContentsMargins(0, 0, 4, 0)
        self.filter.toggled.connect(second.setVisible)
        self.filter.toggled.connect(self.options_changed)
        for edit in (self.nodelets, self.topics):
            edit.filter_changed.connect(self._filter)

    def _draw_icons(self) -> None:
        for name, action in self._icons.items():
            action.setIcon(_icon_of(name, self.palette()))
        self._more.setIcon(_icon_of("go-next", self.palette()))

    def _filter(self) -> None:
        if self.nodelets.text() or self.topics.text():
            self.filter.setChecked(True)
        self._typing.start()


def _with_keys(action: QAction, *keys: str) -> QAction:
    """Let keys trigger an action from anywhere in the window."""
    action.setShortcuts([QKeySequence(key) for key in keys])
    action.setShortcutContext(Qt.WidgetWithChildrenShortcut)
    return action


def _explain(action: QAction, tip: str) -> None:
    keys = ", ".join(key.toString() for key in action.shortcuts())
    action.setToolTip(f"{tip} ({keys})" if keys else tip)


def _icon_of(name: str, palette: QPalette) -> QIcon:
    """The icon of a name; one that is drawn has the colour of the palette's text."""
    drawn = QPixmap(_ICON, _ICON)
    drawn.fill(Qt.transparent)
    colour = palette.color(QPalette.Active, QPalette.ButtonText).name()
    painter = QPainter(drawn)
    QSvgRenderer(QByteArray(_SVG.format(_LINES[name], colour).encode())).render(painter)
    painter.end()
    return QIcon.fromTheme(name, QIcon(drawn))
