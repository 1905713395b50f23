# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The window without a mouse."""

from __future__ import annotations

from threading import Event

from python_qt_binding.QtCore import Qt
from python_qt_binding.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QLabel,
    QWidget,
)
from unit.rqt.hands import CEILING, button_of, create, description_of, texts_of, until

from dyknow_rqt.monitoring.simulated import soccer
from dyknow_rqt.widgets import KEYS, KeysDialog


def with_focus(window):
    """Widgets that take the focus; a composite widget counts as a whole."""
    return [
        widget
        for widget in window.findChildren(QWidget)
        if widget.focusPolicy() & Qt.TabFocus
        and not isinstance(widget.parent(), (QAbstractSpinBox, QComboBox))
        and not widget.focusProxy()
    ]


def test_everything_is_reached_with_the_tab_key(qtbot, window):
    for number in range(window.tabs.count()):
        window.tabs.setCurrentIndex(number)
        window.tabs.currentWidget().setFocus()
        reached = set()
        for _ in range(80):
            window.focusNextPrevChild(True)
            reached.add(QApplication.focusWidget())
        wanted = {each for each in with_focus(window) if each.isVisible() and each.isEnabled()}
        assert {description_of(each) for each in wanted - reached} == set()


def test_no_letter_is_given_twice(window):
    letters = [window.tabs.tabText(i) for i in range(window.tabs.count())]
    letters += texts_of(window.graph.bar)
    for number in range(window.tabs.count()):
        found = letters + texts_of(window.tabs.widget(number))
        keys = [text[text.index("&") + 1].upper() for text in found if "&" in text]
        assert sorted(keys) == sorted(set(keys)), window.tabs.tabText(number)


def test_return_presses_what_is_focused(qtbot, window, remote):
    window.active.table.choose(["/field/tracker"])
    window.active.destroy.setFocus()
    qtbot.keyClick(window.active.destroy, Qt.Key_Return)
    assert window.line.text == "Destroy /field/tracker?"
    until(qtbot, window.line.yes.hasFocus)
    qtbot.keyClick(window.line.yes, Qt.Key_Return)
    until(qtbot, lambda: remote.graph().nodelet("/field/tracker") is None)
    button = button_of(window.graph.bar.filter)
    button.setFocus()
    qtbot.keyClick(button, Qt.Key_Enter)
    assert window.graph.bar.nodelets.isVisible()
    window.tabs.setCurrentWidget(window.library)
    window.library.table.choose(["tracker"])
    qtbot.keyClick(window.library.table, Qt.Key_Return)
    assert window.tabs.currentWidget() is window.create_
    assert window.create_.label.currentText() == "tracker"


def test_escape_takes_a_question_back_from_everywhere(qtbot, window, remote):
    places = [
        (window.active, window.active.table),
        (window.library, window.library.table.filter),
        (window.create_, window.create_.name),
        (window.connect_, window.connect_.source.nodelet),
        (window.streams, window.streams.plan),
        (window.streams, window.graph.view),
        (window.streams, window.graph.bar.search),
        (window.streams, window.line.yes),
    ]
    for tab, place in places:
        window.tabs.setCurrentWidget(tab)
        window.graph.edits.ask_to_destroy(["/field/tracker"])
        until(qtbot, window.line.yes.hasFocus)
        place.setFocus()
        qtbot.keyClick(place, Qt.Key_Escape)
        assert window.line.text == ""
    assert remote.graph().nodelet("/field/tracker") is not None


def test_a_question_about_many_is_short(qtbot, window, remote):
    names = [each.name for each in remote.graph().nodelets if not each.is_protected]
    window.graph.edits.ask_to_destroy(names)
    assert window.line.text.startswith("Destroy 9 nodelets?")
    label = next(each for each in window.line.findChildren(QLabel) if "Destroy" in each.text())
    assert all(name in label.toolTip() for name in names)


def test_after_a_question_the_focus_is_where_it_was(qtbot, window):
    for answer in (window.line.no.click, lambda: qtbot.keyClick(window.line.yes, Qt.Key_Escape)):
        window.active.table.setFocus()
        window.graph.edits.ask_to_destroy(["/field/tracker"])
        window.graph.edits.ask_to_destroy(["/nao1/resize"])  # another question instead
        until(qtbot, window.line.yes.hasFocus)
        answer()
        assert window.active.table.hasFocus()


def test_escape_dismisses_an_error_but_first_ends_a_connection(qtbot, window, remote, view):
    window.line.report("wrong")
    qtbot.mousePress(view.viewport(), Qt.LeftButton, Qt.NoModifier, view.place_of(CEILING))
    assert view.wire.isVisible()
    qtbot.keyClick(view, Qt.Key_Escape)
    assert not view.wire.isVisible() and window.line.text == "wrong"
    qtbot.keyClick(view, Qt.Key_Escape)
    assert window.line.text == ""


def test_the_keys_are_listed_in_the_window(qtbot, window):
    window.active.table.setFocus()
    qtbot.keyClick(window.active.table, Qt.Key_Question, Qt.ShiftModifier)
    dialog = window.findChild(KeysDialog)
    assert dialog.isVisible()
    labels = dialog.findChildren(QLabel)
    texts = [label.text() for label in labels]
    assert all(what in texts for _, what in KEYS)
    assert all(each.height() >= each.heightForWidth(each.width()) for each in labels)
    dialog.close()
    for action in window.actions():
        for shortcut in action.shortcuts():
            text = shortcut.toString()
            assert any(text in " ".join(entry) for entry in KEYS), text
    window.tabs.setCurrentWidget(window.streams)
    qtbot.keyClick(window.streams.tag, Qt.Key_Question, Qt.ShiftModifier)
    assert window.streams.tag.text() == "?", "a variable begins with it"


def test_everything_that_takes_the_focus_has_a_name(window):
    window.graph.edits.ask_to_destroy(["/field/tracker"])
    buddies = {label.buddy() for label in window.findChildren(QLabel)}
    nameless = [
        description_of(widget)
        for widget in with_focus(window)
        if widget.window() is window
        and not (isinstance(widget, QAbstractButton) and widget.text())
        and not widget.accessibleName()
        and widget not in buddies
    ]
    assert nameless == []


def test_undo_is_the_graphs_unless_a_field_has_something_to_undo(qtbot, window, remote):
    create(qtbot, window, "/first")
    tag = window.streams.tag
    qtbot.keyClick(window, Qt.Key_S, Qt.AltModifier)
    assert window.tabs.currentWidget() is window.streams
    until(qtbot, tag.hasFocus)
    qtbot.keyClicks(tag, "Track(ball)")
    qtbot.keyClick(tag, Qt.Key_Z, Qt.ControlModifier)
    assert tag.text() == "" and window.monitor.snapshot.nodelet("/first")
    qtbot.keyClicks(tag, "Track(ball)")
    qtbot.keyClick(tag, Qt.Key_Return)
    qtbot.keyClick(tag, Qt.Key_Z, Qt.ControlModifier)
    until(qtbot, lambda: window.monitor.snapshot.nodelet("/first") is None)
    assert tag.text() == "Track(ball)"
    until(qtbot, lambda: not window.monitor.is_changing)
    qtbot.keyClick(tag, Qt.Key_Z, Qt.ControlModifier | Qt.ShiftModifier)
    until(qtbot, lambda: window.monitor.snapshot.nodelet("/first"))


def test_undo_is_the_graphs_in_spin_boxes_and_combo_boxes_too(qtbot, window):
    rate, label = window.streams.rate, window.create_.label
    for name in ("/n0", "/n1"):
        create(qtbot, window, name)
    window.tabs.setCurrentWidget(window.create_)
    label.setFocus()
    until(qtbot, label.hasFocus)
    before = label.currentText()
    label.lineEdit().selectAll()
    qtbot.keyClicks(label, "7")
    assert label.currentText() == "7"
    qtbot.keyClick(label, Qt.Key_Z, Qt.ControlModifier)
    assert label.currentText() == before and not window.monitor.is_changing
    qtbot.keyClick(label, Qt.Key_Z, Qt.ControlModifier)
    until(qtbot, lambda: window.monitor.snapshot.nodelet("/n1") is None)
    until(qtbot, lambda: not window.monitor.is_changing)
    window.tabs.setCurrentWidget(window.streams)
    rate.setFocus()
    until(qtbot, rate.hasFocus)
    qtbot.keyClick(rate, Qt.Key_Z, Qt.ControlModifier)
    until(qtbot, lambda: window.monitor.snapshot.nodelet("/n0") is None)


def test_a_look_that_began_at_another_manager_says_nothing_about_this_one(qtbot, window, remote):
    create(qtbot, window, "/first")
    graph, has_read, goes_on = remote.graph, Event(), Event()

    def slow():
        model = graph()
        has_read.set()
        goes_on.wait(60)
        return model

    remote.graph = slow
    until(qtbot, has_read.is_set)
    remote.graph = graph
    other = soccer()
    remote.client.core, remote.client.host = other.client.core, other.client.host
    remote.address = "rosrpc://localhost:40002"
    until(qtbot, lambda: window.monitor.heart._address == remote.address)
    goes_on.set()
    until(qtbot, lambda: window.monitor.snapshot.nodelet("/first") is None)
    assert window.monitor.history.texts == ("", "")
