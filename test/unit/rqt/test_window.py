# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The window as a whole: managers that are slow or away, undo, settings, many nodelets."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from unittest.mock import Mock

import pytest
from clocks import PATIENCE
from python_qt_binding.QtCore import QEvent, QObject, QSize, QTimer
from python_qt_binding.QtWidgets import QApplication, QMainWindow, QWidget
from unit.rqt.hands import (
    TRACKER,
    click,
    create,
    is_ready,
    pauses,
    show,
    turn_wheel,
    undo,
    until,
    vertex_keys,
    window_of,
)

from dyknow.model.graph import SpawnRequest
from dyknow.model.transformation import as_specification
from dyknow_rqt.graph.changes import add_transformations, destroy, protect, spawn
from dyknow_rqt.graph.wiring import connect_topic
from dyknow_rqt.monitoring.simulated import tree
from dyknow_rqt.window import DyKnowWidget, make_room


def test_a_manager_that_hangs_does_not_hold_up_the_window(qtbot, window, remote):
    answers, ticks, timer = remote.client.answers, [], QTimer()
    answers.clear()
    window.monitor.do(protect("/field/tracker", True))
    assert window.line.text == "protect /field/tracker …"
    timer.timeout.connect(lambda: ticks.append(1))
    timer.start(10)
    last = threading.Timer(PATIENCE, answers.set)
    last.start()
    until(qtbot, lambda: len(ticks) > 100)
    timer.stop()
    assert not answers.is_set(), "the window has waited for the manager"
    last.cancel()
    answers.set()
    until(qtbot, lambda: window.line.text == "done: protect /field/tracker")


def test_a_change_begins_from_the_graph_that_the_last_one_left(qtbot, remote, monkeypatch):
    late = remote.graph()
    monkeypatch.setattr(remote, "graph", lambda: late)  # messages of the model are on the way
    monkeypatch.setattr(remote, "start", lambda: None)
    window = window_of(qtbot, remote)
    monitor, name = window.monitor, "/field/tracker"

    def connected():
        ports = remote.client.get_config(name)
        return {port.name: port.topic for port in ports}["position"]

    until(qtbot, lambda: monitor.snapshot.nodelet(name) and monitor.library)
    until(qtbot, lambda: is_ready(window))
    assert connected() == "/field/ball"
    for change in (connect_topic(monitor.snapshot, TRACKER, "/other"), destroy(name)):
        monitor.do(change)
        until(qtbot, lambda: not monitor.is_changing)
    undo(qtbot, window)
    until(qtbot, lambda: not monitor.is_changing)
    assert connected() == "/other"


@pytest.mark.parametrize("is_whole", [True, False])
def test_a_change_begins_from_the_library_that_the_last_one_left(
    qtbot, window, remote, monkeypatch, is_whole
):
    monitor, client = window.monitor, remote.client
    fresh = monitor.library["tracker"]._replace(label="fresh")
    monkeypatch.setattr(monitor, "read_library", lambda: None)  # its answer is on the way
    if is_whole:
        monkeypatch.setattr(client, "get_graph", client.get_model)  # as that of a real manager
    for change in (
        add_transformations(as_specification([fresh])),
        spawn(SpawnRequest("fresh", "/fresh")),
        destroy("/fresh"),
    ):
        monitor.do(change)
        until(qtbot, lambda: not monitor.is_changing)
    assert remote.graph().nodelet("/fresh") is None
    monitor.undo()
    until(qtbot, lambda: not monitor.is_changing)
    assert remote.graph().nodelet("/fresh") is not None


def test_a_library_that_was_read_before_a_newer_one_is_not_taken(qtbot, window, remote):
    monitor, client = window.monitor, remote.client
    late, link = client.get_model(), monitor._link
    client.remove_transformation("tracker")
    until(qtbot, lambda: "tracker" not in monitor.library)
    monitor._take_library(late, link)
    assert "tracker" not in monitor.library


def test_a_model_that_comes_after_a_newer_one_is_not_shown(qtbot, window, remote):
    monitor, late, seen, turns = window.monitor, remote.graph(), [], []
    monitor.do(connect_topic(monitor.snapshot, TRACKER, "/other"))
    until(qtbot, lambda: not monitor.is_changing)
    until(qtbot, lambda: not (monitor._calls.is_calling or monitor._drawing.isActive()))
    assert monitor.snapshot.port(TRACKER).topic == "/other"
    monitor.changed.connect(lambda snapshot: seen.append(snapshot.port(TRACKER).topic))
    remote.on_model(late)
    monitor._calls.deliver(lambda: turns.append(1))
    until(qtbot, lambda: turns and not monitor._drawing.isActive())
    assert set(seen) <= {"/other"}


def test_what_cannot_be_undone_is_not_in_the_way_of_what_was_done_before(qtbot, window, remote):
    for name in ("/first", "/second"):
        create(qtbot, window, name)
    remote.client.destroy("/second")
    undo(qtbot, window)
    until(qtbot, lambda: "cannot undo 'create /second': /second is gone" in window.line.text)
    undo(qtbot, window)
    until(qtbot, lambda: window.monitor.snapshot.nodelet("/first") is None)
    until(qtbot, lambda: not window.graph.bar.undo.isEnabled())


def test_a_manager_that_does_not_answer_keeps_what_can_be_undone(qtbot, window, remote):
    create(qtbot, window, "/first")
    remote.client.is_up = False
    window.monitor.undo()
    until(qtbot, lambda: "undo 'create /first': " in window.line.text)
    remote.client.is_up = True
    # Its silence may have been noticed.
    until(qtbot, lambda: is_ready(window))
    undo(qtbot, window)
    until(qtbot, lambda: window.monitor.snapshot.nodelet("/first") is None)


@pytest.mark.qt_no_exception_capture
def test_a_slot_that_raises_leaves_a_line_and_a_living_window(qtbot, window, monkeypatch, capsys):
    monkeypatch.setattr(window.graph.view.scene(), "find", lambda text: 1 / 0)
    qtbot.keyClicks(window.graph.bar.search, "x")
    assert "ZeroDivisionError" in window.line.text
    window.line.clear()
    QTimer.singleShot(0, lambda: 1 / 0)  # in another part of the process
    until(qtbot, lambda: "ZeroDivisionError" in capsys.readouterr().err)
    assert window.line.text == ""


def test_settings_are_kept(qtbot, window, remote):
    window.graph.bar.choose("depth", 1)
    window.graph.bar.topics.setText("-/x")
    window.tabs.setCurrentIndex(2)
    other = DyKnowWidget(remote)
    qtbot.addWidget(other, before_close_func=lambda w: w.shut_down())
    other.restore({**window.state(), "mode": "nonsense", "tab": "2", "parts": "1,x"})
    assert other.state()["depth"] == "1" and other.state()["topics"] == "-/x"
    assert other.state()["mode"] == "0" and other.tabs.currentIndex() == 2


def test_narrow_and_wide_windows_keep_their_own_sizes_of_parts(qtbot, window, remote):
    for sizes in ([250, 600], [650, 150]):
        window.resize(600, 900)
        window.parts.setSizes(sizes)
        graph, panel = window.parts.sizes()
        assert (graph < panel) is (sizes[0] < sizes[1])
        other = DyKnowWidget(remote)
        qtbot.addWidget(other, before_close_func=lambda w: w.shut_down())
        other.restore(window.state())
        other.resize(600, 900)
        other.show()
        graph, panel = other.parts.sizes()
        assert (graph < panel) is (sizes[0] < sizes[1])
        for size in ((1400, 800), (600, 900)):
            other.resize(*size)
        graph, panel = other.parts.sizes()
        assert (graph < panel) is (sizes[0] < sizes[1])
        other.resize(1400, 800)
        assert other.parts.sizes()[0] < 600, "the panel has its share of a wide window"


def test_an_error_in_a_narrow_window_can_be_read(qtbot, window):
    line = window.line
    until(qtbot, lambda: window.health.text().count("<a ") == 3)
    window.resize(600, 450)
    line.report(
        "'/nao1/line_detector:hsv' expects sensor_msgs/Image, but "
        "'/field/ceiling_camera:field_position' has geometry_msgs/PointStamped"
    )
    until(qtbot, lambda: line.height() < 450 / 4 and line._text.width() > 600 / 3)
    assert not line.contact.isVisible()
    click(qtbot, line.dismiss)
    assert line.contact.isVisible()


@pytest.mark.parametrize("is_shown", [False, True])
def test_a_hidden_control_panel_comes_back_after_a_restart(qtbot, window, remote, is_shown):
    click(qtbot, window.graph.bar.panel)
    until(qtbot, lambda: window.parts.sizes()[0] == 0)
    other = DyKnowWidget(remote)
    qtbot.addWidget(other, before_close_func=lambda w: w.shut_down())
    other.resize(window.size())
    other.setVisible(is_shown)  # as in rqt, which restores a widget that it has shown
    other.restore(window.state())
    other.show()
    assert not other.tabs.isVisible()
    click(qtbot, other.graph.bar.panel)
    until(qtbot, lambda: not other.tabs.visibleRegion().isEmpty())


def test_the_graph_has_most_of_the_room_and_the_control_panel_scrolls(qtbot, window):
    for _ in range(2):
        window.graph.bar.panel.trigger()  # it is wanted in small windows too

    def is_whole(tab):
        width, layout = tab.page.width(), tab.page.layout()
        least = layout.heightForWidth(width) if layout.hasHeightForWidth() else 0
        least = max(least, layout.minimumSize().height())
        return tab.page.height() >= least and width >= layout.minimumSize().width()

    for size in ((1400, 800), (1024, 700), (640, 480), (640, 900), (1024, 700)):
        window.resize(*size)
        panel, graph = window.parts.sizes()[:: 1 if size[0] > size[1] else -1]
        assert graph >= 0.6 * (panel + graph) or size == (640, 480)
        for tab in (window.library, window.create_, window.connect_, window.streams):
            show(window, tab)
            until(qtbot, lambda tab=tab: is_whole(tab))
        until(qtbot, lambda: window.streams.table.viewport().height() > 24)  # a row is seen


def test_the_wheel_scrolls_a_page_over_a_box_that_is_not_edited(qtbot, window):
    for _ in range(2):
        window.graph.bar.panel.trigger()  # it is wanted in small windows too
    window.resize(640, 480)
    until(qtbot, lambda: show(window, window.streams).verticalScrollBar().maximum() > 0)
    box, bar = window.streams.silence, window.streams.verticalScrollBar()
    turn_wheel(box, box.rect().center(), -120)
    assert bar.value() > 0 and box.value() == 0.0
    box.setFocus()
    turn_wheel(box, box.rect().center(), 120)
    assert box.value() > 0.0


@pytest.mark.long
def test_five_hundred_nodelets_stay_usable(qtbot):
    remote = tree(500)
    widget, client = window_of(qtbot, remote), remote.client

    def spawn_more():
        for i in range(100):
            topics = {"in": f"/more/t{i}", "out": f"/more/t{i + 1}"}
            client.spawn("relay", f"/more/n{i}", topics)

    for change, last in (
        (lambda: None, "n_/part49/nodelet9"),
        (lambda: client.set_config("/part7/nodelet3", {"in": "/elsewhere"}), "t_/elsewhere"),
        (spawn_more, "n_/more/n99"),
    ):
        change()
        worst = max(pauses(qtbot, 180000, lambda last=last: last in vertex_keys(widget)))
        assert last in vertex_keys(widget) and worst < 2.0, worst
    zoom = widget.graph.view.zoom
    widget.graph.bar.nodelets.setText("/part7")
    until(qtbot, lambda: widget.graph.view.zoom > 3 * zoom)


@pytest.mark.parametrize(("size", "grows"), [((380, 190), True), ((500, 330), False)])
def test_a_window_in_which_no_graph_can_be_seen_makes_room(qtbot, size, grows):
    host = QMainWindow()
    host.screen = None  # new in Qt 5.14
    qtbot.addWidget(host)
    widget = QWidget()
    widget.sizeHint = lambda: QSize(700, 500)
    host.setCentralWidget(widget)
    host.resize(*size)
    host.show()
    make_room(widget)
    assert (host.width() > size[0]) is grows
    screen = QApplication.desktop().availableGeometry(host)
    assert host.width() <= screen.width() and host.height() <= screen.height()


class Plugin(QObject):
    """As rqt's own, which is not installed everywhere."""

    def __init__(self, context):
        super().__init__()


def test_a_plugin_that_is_closed_at_once_makes_no_room(qtbot, remote, monkeypatch):
    monkeypatch.setitem(sys.modules, "rqt_gui_py", Mock())
    monkeypatch.setitem(sys.modules, "rqt_gui_py.plugin", Mock(Plugin=Plugin))
    from dyknow_rqt import plugin

    monkeypatch.setattr(plugin, "RosRemote", lambda manager: remote)
    monkeypatch.setattr(plugin, "spare_imports", lambda: None)
    monkeypatch.setattr(plugin, "_AFTER_RQT", 0)
    context = Mock(**{"argv.return_value": [], "serial_number.return_value": 1})
    closed, turns = plugin.DyKnowPlugin(context), []
    closed.shutdown_plugin()
    closed._widget.deleteLater()
    QApplication.sendPostedEvents(closed._widget, QEvent.DeferredDelete)
    QTimer.singleShot(1, lambda: turns.append(1))
    until(qtbot, lambda: turns)


def test_without_a_screen_it_says_so() -> None:
    hidden = ("QT_QPA_PLATFORM", "DISPLAY", "WAYLAND_DISPLAY")
    environment = {name: text for name, text in os.environ.items() if name not in hidden}
    start = "import sys; from dyknow_rqt.main import main; sys.exit(main(['dyknow_rqt']))"
    done = subprocess.run(
        [sys.executable, "-c", start], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("dyknow_rqt: there is no screen: set DISPLAY")
