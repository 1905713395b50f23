# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The bar above the graph: options of the drawing, placed as in rqt_graph."""

from __future__ import annotations

import contextlib
from typing import Any, Dict, FrozenSet, Iterable, List, Optional

from python_qt_binding.QtCore import QEvent, QSize, QTimer, Signal
from python_qt_binding.QtWidgets import (
    QCheckBox,
    QComboBox,
    QLabel,
    QLineEdit,
    QMenu,
    QPushButton,
    QSpinBox,
    QToolButton,
    QWidget,
)

from dyknow_rqt.background_calls import qt_slot
from dyknow_rqt.graph.figure import Boxes, Group, Options
from dyknow_rqt.widgets import FilterEdit, FlowLayout, row_of

_TYPING = 250  # ms
#: Pixels: from this width on the whole bar is shown.
_WIDE = 800
#: Wider parts are folded before the text gets so narrow.
_LEAST = 190
#: A view is narrow if it is so many times higher than wide.
_NARROW = 1.2
#: The fields whose settings are saved, under these names.
_CHECKS = ("dead_sinks", "leaf_topics", "debug", "nodes", "highlight")
_CHOICES = ("mode", "direction", "boxes")
_FILTERS = ("nodelets", "topics")


class GraphBar(QWidget):
    """Edits the options; its state is a dictionary of texts."""

    #: The options have changed.
    options_changed = Signal()
    #: They have changed so much that the old layout has no meaning.
    structure_changed = Signal()

    def __init__(self, parent: Optional[QWidget] = None) -> None:
        super().__init__(parent)
        self.refresh = QPushButton("&Refresh")
        self.refresh.setToolTip("Read everything now (F5, Ctrl+R)")
        self.mode = QComboBox()
        self.mode.addItems(["Nodelets/Topics", "Nodelets only"])
        self.mode.setAccessibleName("What to draw")
        self.direction = QComboBox()
        self.direction.addItems(["Flow: automatic", "Flow: to the right", "Flow: downwards"])
        self.direction.setAccessibleName("Where streams flow to")
        self.direction.setToolTip("Automatic: downwards where the graph has a narrow place")
        self.nodelets = FilterEdit("nodelets")
        self.topics = FilterEdit("topics")
        self.depth = QSpinBox()
        self.depth.setRange(0, 5)
        self.depth.setValue(2)
        self.depth.setToolTip(
            "How many boxes stand in each other: parts of a namespace, or host and manager; "
            "0 for none"
        )
        self.boxes = QComboBox()
        self.boxes.addItems([each.value for each in Boxes])
        self.boxes.setAccessibleName("What makes a box")
        self.boxes.setToolTip("What makes a box; a double click collapses a box and opens it")
        self.collapsed: FrozenSet[Group] = frozenset()
        self.dead_sinks = QCheckBox("Dead sin&ks", toolTip="Hide topics without a receiver")
        self.leaf_topics = QCheckBox("&Leaf topics", toolTip="Hide topics with only one end")
        self.debug = QCheckBox(
            "Debu&g",
            checked=True,
            toolTip="Hide what is in every graph: /rosout, /clock, rviz, rqt …",
        )
        self.nodes = QCheckBox(
            "ROS &nodes", toolTip="Show ordinary nodes that use these topics, greyed"
        )
        self.highlight = QCheckBox(
            "&Highlight",
            checked=True,
            toolTip="Highlight the neighbours of the thing under the pointer",
        )
        self.fit = QPushButton("&Fit")
        self.fit.setToolTip("Fit everything into the view (Ctrl+0)")
        self.tidy = QPushButton("Tid&y")
        self.tidy.setToolTip("Make a new layout (Ctrl+L)")
        self.undo = QPushButton("Undo")
        self.redo = QPushButton("Redo")
        self.save = QToolButton()
        self.save.setText("Sa&ve")
        self.save.setToolTip("Save the drawing, or the wiring")
        self.save.setPopupMode(QToolButton.InstantPopup)
        self.save_menu = QMenu(self.save)
        self.save.setMenu(self.save_menu)
        self.load = QPushButton("Loa&d …")
        self.load.setToolTip("Load a wiring: nodelets and their connections")
        self.search = QLineEdit()
        self.search.setPlaceholderText("find (Ctrl+F)")
        self.search.setClearButtonEnabled(True)
        self.search.setAccessibleName("Find")
        self.search.setMaximumWidth(170)
        self.hits = QLabel()
        self.panel = QPushButton("Panel")
        self.panel.setCheckable(True)
        self.panel.setChecked(True)
        self.panel.setToolTip("Show the control panel (F9)")
        self.panel.setShortcut("F9")
        self.more = QPushButton("More")
        self.more.setCheckable(True)
        self.more.setToolTip("Show everything that this bar has")
        self._folded: List[QWidget] = []
        self._is_chosen = False
        self._typing = QTimer(self)
        self._typing.setSingleShot(True)
        self._typing.setInterval(_TYPING)
        self._typing.timeout.connect(self._tell)
        self._arrange()
        self._listen()

    def is_downwards(self, view: QSize) -> bool:
        """Whether streams flow downwards in a view of that size."""
        is_narrow = bool(view.height() > _NARROW * view.width())
        return (is_narrow, False, True)[self.direction.currentIndex()]

    def options(self, view: QSize) -> Options:
        return Options(
            is_downwards=self.is_downwards(view),
            topics=self.mode.currentIndex() == 0,
            nodelet_filter=self.nodelets.filter,
            topic_filter=self.topics.filter,
            hide_dead_sinks=self.dead_sinks.isChecked(),
            hide_leaf_topics=self.leaf_topics.isChecked(),
            hide_debug=self.debug.isChecked(),
            show_nodes=self.nodes.isChecked(),
            boxes=Boxes(self.boxes.currentText()),
            depth=self.depth.value(),
            collapsed=self.collapsed,
        )

    def state(self) -> Dict[str, str]:
        """The settings to save, as texts."""
        return {
            **{name: str(int(getattr(self, name).isChecked())) for name in _CHECKS},
            **{name: str(getattr(self, name).currentIndex()) for name in _CHOICES},
            "depth": str(self.depth.value()),
            **{name: getattr(self, name).text() for name in _FILTERS},
            "more": str(int(self.more.isChecked())) if self._is_chosen else "",
            "collapsed": "\n".join(" ".join(group) for group in sorted(self.collapsed)),
        }

    def restore(self, state: Dict[str, Any]) -> None:
        """Restore settings; missing or invalid ones are ignored."""
        for name in _CHECKS:
            if state.get(name) in ("0", "1"):
                getattr(self, name).setChecked(state[name] == "1")
        for name in _FILTERS:
            getattr(self, name).setText(str(state.get(name, "")))
        groups = str(state.get("collapsed", "")).splitlines()
        self.collapsed = frozenset(tuple(group.split()) for group in groups if group)
        for name in _CHOICES:
            box = getattr(self, name)
            if state.get(name) in [str(index) for index in range(box.count())]:
                box.setCurrentIndex(int(state[name]))
        if state.get("more") in ("0", "1"):
            self._choose_more(state["more"] == "1")
        with contextlib.suppress(KeyError, TypeError, ValueError):
            self.depth.setValue(int(state["depth"]))

    @qt_slot
    def collapse(self, groups: Iterable[Group]) -> None:
        """Draw these boxes as one vertex each, and only these."""
        self.collapsed = frozenset(groups)
        self._tell_structure()

    @qt_slot
    def toggle_box(self, group: Group) -> None:
        self.collapse(self.collapsed ^ {group})

    def show_history(self, undo: str, redo: str) -> None:
        for button, text, keys in ((self.undo, undo, "Ctrl+Z"), (self.redo, redo, "Ctrl+Shift+Z")):
            button.setEnabled(bool(text))
            button.setToolTip(f"{button.text().replace('&', '')}: {text or 'nothing'} ({keys})")

    def _arrange(self) -> None:
        self.mode.setSizeAdjustPolicy(QComboBox.AdjustToContents)
        rows = FlowLayout(self)
        rows.setContentsMargins(4, 4, 4, 2)
        self.setMinimumWidth(_LEAST)
        for edit in (self.nodelets, self.topics):
            edit.setMinimumWidth(150)
        for button in (self.panel, self.undo, self.redo, self.fit, self.more):
            button.setMinimumWidth(40)  # styles make them wider than their words
        group = QLabel("Gro&up:")
        group.setBuddy(self.depth)
        self._folded = [
            _together(self.mode),
            self.nodelets,
            self.topics,
            _together(self.save, self.load),
            _together(self.refresh, self.tidy),
            self.direction,
            _together(group, self.depth, self.boxes),
            _together(QLabel("Hide:"), self.dead_sinks, self.leaf_topics, self.debug),
            _together(QLabel("Show:"), self.nodes, self.highlight),
        ]
        for part in (
            _together(self.panel, self.search, self.hits),
            _together(self.undo, self.redo, self.fit, self.more),
            *self._folded,
        ):
            rows.addWidget(part)
        self._fold()
        self.show_history("", "")

    def _listen(self) -> None:
        self.mode.currentIndexChanged.connect(self._tell_structure)
        for box in (self.direction, self.boxes):
            box.currentIndexChanged.connect(self._tell_structure)
        self.depth.valueChanged.connect(self._tell_structure)
        self.more.clicked.connect(self._choose_more)
        for box in (self.dead_sinks, self.leaf_topics, self.debug, self.nodes):
            box.toggled.connect(self._tell)
        for edit in (self.nodelets, self.topics):
            edit.filter_changed.connect(self._typing.start)

    @qt_slot
    def resizeEvent(self, event: QEvent) -> None:  # noqa: N802
        """Fold the rows beyond two lines, unless the user has said what to show."""
        super().resizeEvent(event)
        if not self._is_chosen:
            self._fold(self.width() >= _WIDE)

    @qt_slot
    def _choose_more(self, on: bool) -> None:
        self._is_chosen = True
        self._fold(on)

    def _fold(self, is_open: bool = False) -> None:
        self.more.setChecked(is_open)
        for part in self._folded:
            part.setVisible(is_open)

    @qt_slot
    def _tell(self) -> None:
        self.options_changed.emit()

    @qt_slot
    def _tell_structure(self) -> None:
        self.structure_changed.emit()


def _together(*widgets: QWidget) -> QWidget:
    part, row = QWidget(), row_of(*widgets)
    row.setContentsMargins(0, 0, 0, 0)
    row.setSpacing(6)
    part.setLayout(row)
    return part
