# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The window without a mouse."""

from __future__ import annotations

from python_qt_binding.QtCore import Qt
from python_qt_binding.QtWidgets import (
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QWidget,
)
from unit.rqt.hands import (
    description_of,
    texts_of,
    until,
)


def test_everything_is_reached_with_the_tab_key(qtbot, window):
    for number in range(window.tabs.count()):
        window.tabs.setCurrentIndex(number)
        window.tabs.currentWidget().setFocus()
        reached = set()
        for _ in range(80):
            window.focusNextPrevChild(True)
            reached.add(QApplication.focusWidget())
        wanted = {
            widget
            for widget in window.findChildren(QWidget)
            if widget.isVisible()
            and widget.isEnabled()
            and widget.focusPolicy() & Qt.TabFocus
            # of what is put together, only the whole listens to keys
            and not isinstance(widget.parent(), (QAbstractSpinBox, QComboBox))
            and not widget.focusProxy()
        }
        assert {description_of(each) for each in wanted - reached} == set()


def test_no_letter_is_given_twice(window):
    letters = [window.tabs.tabText(i) for i in range(window.tabs.count())]
    letters += texts_of(window.graph.bar)
    for number in range(window.tabs.count()):
        found = letters + texts_of(window.tabs.widget(number))
        keys = [text[text.index("&") + 1].upper() for text in found if "&" in text]
        assert sorted(keys) == sorted(set(keys)), window.tabs.tabText(number)


def test_escape_says_no(qtbot, window, remote):
    window.active.ask_to_destroy(["/field/tracker"])
    until(qtbot, window.line.yes.hasFocus)
    qtbot.keyClick(window.line.yes, Qt.Key_Escape)
    assert window.line.text == ""
    assert remote.graph().nodelet("/field/tracker") is not None
