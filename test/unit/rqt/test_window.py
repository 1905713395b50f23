"""The window, used as a person uses it: clicks, keys, drags; on a manager that is made up."""

from __future__ import annotations

import time

import pydot
import pytest
from python_qt_binding.QtCore import QEvent, QPoint, QPointF, Qt, QTimer
from python_qt_binding.QtGui import QImage, QMouseEvent, QPalette, QWheelEvent
from python_qt_binding.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QFileDialog,
    QLabel,
    QLineEdit,
    QMenu,
    QMessageBox,
    QWidget,
)

from dyknow_rqt.graph.changes import SpawnNodelet
from dyknow_rqt.graph.snapshot import PortRef
from dyknow_rqt.layouter import Layouter
from dyknow_rqt.screenshots import dark_palette
from dyknow_rqt.simulated import SimulatedRemote
from dyknow_rqt.window import DyKnowWidget

CEILING = PortRef("/field/ceiling_camera", "field_position")
TRACKER = PortRef("/field/tracker", "position")
HSV_IN = PortRef("/nao1/line_detector", "hsv")


def until(qtbot, condition):
    """Wait for something, as long as a busy machine may need."""
    qtbot.waitUntil(condition, timeout=20_000)


def topic(remote, ref):
    nodelet = remote.graph().nodelet(ref.nodelet)
    return nodelet.port(ref.port).topic


def drag(view, start, end):
    """Press, move and release, as a hand does."""
    port = view.viewport()
    for kind, place, button, buttons in (
        (QEvent.MouseButtonPress, start, Qt.LeftButton, Qt.LeftButton),
        (QEvent.MouseMove, (start + end) / 2, Qt.NoButton, Qt.LeftButton),
        (QEvent.MouseMove, end, Qt.NoButton, Qt.LeftButton),
        (QEvent.MouseButtonRelease, end, Qt.LeftButton, Qt.NoButton),
    ):
        event = QMouseEvent(
            kind, QPointF(place), QPointF(port.mapToGlobal(place)), button, buttons, Qt.NoModifier
        )
        QApplication.sendEvent(port, event)


def create(qtbot, window, name):
    """Make a nodelet, and wait until the window knows it."""
    window.monitor.do(SpawnNodelet("tracker", name))
    until(qtbot, lambda: not window.monitor.is_changing)
    until(qtbot, lambda: window.monitor.snapshot.nodelet(name) is not None)


def centre_of(view, key):
    return view.mapFromScene(view.scene().vertices[key].pos())


def click(qtbot, button):
    assert button.isEnabled()
    qtbot.mouseClick(button, Qt.LeftButton)


def no_boxes():
    return not [w for w in QApplication.topLevelWidgets() if isinstance(w, QMessageBox)]


# The graph


def test_hovering_lights_up_the_neighbours(qtbot, window):
    scene = window.graph.view.scene()
    qtbot.mouseMove(window.graph.view.viewport(), centre_of(window.graph.view, "n_/nao1/resize"))
    until(qtbot, lambda: scene.vertices["n_/nao1/resize"].tone.value == "self")
    assert scene.vertices["t_/nao1/top_camera/yuv"].tone.value == "in"
    assert scene.vertices["t_/nao1/preview"].tone.value == "out"
    assert scene.vertices["n_/nao1/recorder"].tone.value == "none"


def test_what_is_before_and_behind_is_teal(qtbot, window, remote):
    remote.set_config("/nao1/resize", {"resized": "/nao1/top_camera/yuv"})
    scene = window.graph.view.scene()
    until(qtbot, lambda: "t_/nao1/preview" in scene.vertices)
    until(
        qtbot,
        lambda: any(
            e.tail == "n_/nao1/resize" and e.head == "t_/nao1/top_camera/yuv" for e in scene.edges
        ),
    )
    scene.highlight("n_/nao1/resize")
    assert scene.vertices["t_/nao1/top_camera/yuv"].tone.value == "both"


def test_the_wheel_zooms_where_the_pointer_is(qtbot, window):
    view = window.graph.view
    place = centre_of(view, "n_/nao1/localization")
    qtbot.mouseMove(view.viewport(), place)
    before, zoom = view.mapToScene(place), view.zoom
    turn = QWheelEvent(
        QPointF(place),
        QPointF(view.viewport().mapToGlobal(place)),
        QPoint(0, 0),
        QPoint(0, 240),
        Qt.NoButton,
        Qt.NoModifier,
        Qt.NoScrollPhase,
        False,
    )
    QApplication.sendEvent(view.viewport(), turn)
    assert view.zoom > zoom * 1.3
    after = view.mapToScene(place)
    assert abs(after.x() - before.x()) < 3 and abs(after.y() - before.y()) < 3


def test_a_drag_on_the_ground_moves_the_view(qtbot, window):
    view = window.graph.view
    ground = QPoint(20, view.viewport().height() - 20)
    before = view.mapToScene(0, 0)
    drag(view, ground, ground + QPoint(60, -40))
    after = view.mapToScene(0, 0)
    assert after.x() < before.x() and after.y() > before.y()


def test_filters_hide_and_complain(qtbot, window):
    edit = window.graph.bar.nodelets
    qtbot.keyClicks(edit, "/nao1, -/nao1/.*camera")
    until(qtbot, lambda: "n_/field/tracker" not in _keys(window))
    assert "n_/nao1/resize" in _keys(window) and "n_/nao1/top_camera" not in _keys(window)
    edit.clear()
    until(qtbot, lambda: "n_/field/tracker" in _keys(window))
    qtbot.keyClicks(edit, "/nao[")
    assert "filter '/nao[' is not a regular expression" in window.line.text
    assert "n_/field/tracker" in _keys(window)
    qtbot.keyClicks(edit, "12]")
    assert window.line.text == ""
    until(qtbot, lambda: "n_/field/tracker" not in _keys(window))


def test_options_change_what_is_drawn(qtbot, window, remote):
    bar, readers = window.graph.bar, remote.subscribers
    remote.subscribers = {}
    bar.dead_sinks.setChecked(True)
    until(qtbot, lambda: "t_/field/tracker/track" not in _keys(window))
    remote.subscribers = readers  # with its reader the topic is no dead sink
    bar.nodes.setChecked(True)
    until(qtbot, lambda: "p_/team_view" in _keys(window))
    bar.mode.setCurrentIndex(1)
    until(qtbot, lambda: not any(key.startswith("t_") for key in _keys(window)))
    bar.depth.setValue(0)
    until(qtbot, lambda: window.graph.drawn.groups() == [])


def test_find_selects_one_after_the_other(qtbot, window):
    window.active.table.setFocus()
    qtbot.keyClick(window.active.table, Qt.Key_F, Qt.ControlModifier)
    edit = window.graph.bar.search
    until(qtbot, edit.hasFocus)
    qtbot.keyClicks(edit, "CAMERA")
    assert window.graph.bar.hits.text() == "5 found"
    found = []
    for _ in range(5):
        qtbot.keyClick(edit, Qt.Key_Return)
        found += [item.vertex.name for item in window.graph.view.scene().selectedItems()]
    assert sorted(set(found)) == sorted(found) and len(found) == 5


def test_arrow_keys_walk_through_the_graph(qtbot, window):
    view = window.graph.view
    view.select(view.scene().vertices["n_/nao1/top_camera"])
    seen = []
    for _ in range(2):
        qtbot.keyClick(view, Qt.Key_Right)
        seen += [item.vertex.name for item in view.scene().selectedItems()]
    assert seen == ["/nao1/top_camera/yuv", "/nao1/resize"]


def test_the_drawing_can_be_saved(window, tmp_path):
    for name in ("graph.dot", "graph.svg", "graph.png"):
        window.graph.save(str(tmp_path / name))
    (graph,) = pydot.graph_from_dot_file(str(tmp_path / "graph.dot"))
    assert {box.get_name() for box in graph.get_subgraphs()} == {
        '"cluster_/field"',
        '"cluster_/nao1"',
    }
    assert len(graph.get_edges()) == len(window.graph.drawn.edges)
    assert (
        "ball_detector" in (tmp_path / "graph.svg").read_text()
        or "<path" in (tmp_path / "graph.svg").read_text()
    )
    image = QImage(str(tmp_path / "graph.png"))
    assert image.width() > image.height() > 100
    with pytest.raises(OSError):
        window.graph.save(str(tmp_path / "nowhere" / "graph.png"))


def test_a_name_without_an_ending_gets_that_of_what_was_chosen(qtbot, window, tmp_path):
    def answer():
        found = window.findChildren(QFileDialog)
        found[0].findChild(QLineEdit).setText(str(tmp_path / "graph"))
        found[0].accept()

    QTimer.singleShot(300, answer)
    next(a for a in window.graph.bar.save_menu.actions() if "PNG" in a.text()).trigger()
    assert [path.name for path in tmp_path.iterdir()] == ["graph.png"]
    assert not QImage(str(tmp_path / "graph.png")).isNull()


def test_rates_stand_on_the_arrows_and_drops_are_red(qtbot, window):
    scene = window.graph.view.scene()
    arrow = next(e for e in scene.edges if e.head_port == "channels")
    until(qtbot, lambda: "−" in scene.edges[arrow].label)
    assert "Hz" in scene.edges[arrow].label
    port = scene.port_item(PortRef("/nao1/subsampler", "hsv"))
    assert "sensor_msgs/Image" in port.toolTip() and "HSV(nao1, bottom)" in port.toolTip()


def test_states_are_told_apart(window):
    vertices = window.graph.view.scene().vertices
    badges = {
        key: vertices[f"n_{key}"]._badge()
        for key in (
            "/nao1/bottom_camera",
            "/nao1/resize",
            "/nao1/recorder",
            "/field/ceiling_camera",
            "/field/tracker",
        )
    }
    assert list(badges.values()) == ["protected", "C++", "lost", "failed", ""]
    assert "no device /dev/video4" in vertices["n_/field/ceiling_camera"].toolTip()


def test_the_view_does_not_jump_when_something_comes(qtbot, window, remote):
    view = window.graph.view
    before = {key: item.pos() for key, item in view.scene().vertices.items()}
    corner, zoom = view.mapToScene(0, 0), view.zoom
    remote.spawn("tracker", "/nao1/second_tracker", {"position": "/nao1/ball_detector/ball"})
    until(qtbot, lambda: "n_/nao1/second_tracker" in _keys(window))
    after = view.scene().vertices
    moved = [k for k, place in before.items() if (after[k].pos() - place).manhattanLength() > 16]
    assert len(moved) <= 4
    assert (view.mapToScene(0, 0) - corner).manhattanLength() < 2 and view.zoom == zoom


def test_what_comes_is_seen_until_hands_choose_the_view(qtbot, window, remote):
    view = window.graph.view

    def is_seen():
        seen = view.mapToScene(view.viewport().rect()).boundingRect()
        return seen.contains(view.scene().drawing_area())

    for number in range(12):
        remote.spawn("tracker", f"/more{number}")
    until(qtbot, lambda: "n_/more11" in _keys(window) and is_seen())
    qtbot.keyClick(view, Qt.Key_Plus)
    corner = view.mapToScene(0, 0)
    for number in range(12, 40):
        remote.spawn("tracker", f"/more{number}")
    until(qtbot, lambda: "n_/more39" in _keys(window))
    assert (view.mapToScene(0, 0) - corner).manhattanLength() < 2
    assert not is_seen()
    view.fit()
    window.resize(900, 600)
    until(qtbot, is_seen)


# Gestures


def test_a_drag_from_port_to_port_connects_and_undo_takes_it_back(qtbot, window, remote):
    view = window.graph.view
    drag(view, view.place_of(CEILING), view.place_of(TRACKER))
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ceiling_camera/field_position")
    until(qtbot, window.graph.bar.undo.isEnabled)
    view.setFocus()
    qtbot.keyClick(view, Qt.Key_Z, Qt.ControlModifier)
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ball")
    assert topic(remote, CEILING) == ""
    until(qtbot, window.graph.bar.redo.isEnabled)
    click(qtbot, window.graph.bar.redo)
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ceiling_camera/field_position")


def test_while_a_connection_is_drawn_only_what_fits_is_offered(window):
    view = window.graph.view
    view.drag_began.emit(CEILING)
    offered = {
        port.ref
        for item in view.scene().vertices.values()
        for port in item.ports.values()
        if port.offered
    }
    assert offered == {CEILING, TRACKER, PortRef("/nao1/localization", "objects")}


def test_a_drag_to_a_port_that_does_not_fit_says_why(qtbot, window, remote):
    view = window.graph.view
    drag(view, view.place_of(CEILING), view.place_of(HSV_IN))
    assert "but /nao1/line_detector:hsv expects sensor_msgs/Image" in window.line.text
    assert topic(remote, CEILING) == "" and no_boxes()


def test_a_drag_to_a_topic_connects_to_it(qtbot, window, remote):
    view = window.graph.view
    drag(view, view.place_of(CEILING), centre_of(view, "t_/field/ball"))
    until(qtbot, lambda: topic(remote, CEILING) == "/field/ball")


def test_delete_disconnects_the_selected_arrow(qtbot, window, remote):
    scene = window.graph.view.scene()
    arrow = next(e for e in scene.edges if e.head == "n_/field/tracker")
    scene.edges[arrow].setSelected(True)
    qtbot.keyClick(window.graph.view, Qt.Key_Delete)
    until(qtbot, lambda: topic(remote, TRACKER) == "")


def test_delete_destroys_selected_nodelets_after_asking(qtbot, window, remote):
    window.graph.view.select(window.graph.view.scene().vertices["n_/field/tracker"])
    qtbot.keyClick(window.graph.view, Qt.Key_Delete)
    assert window.line.text == "Destroy /field/tracker?"
    click(qtbot, window.line.no)
    assert remote.graph().nodelet("/field/tracker") is not None
    qtbot.keyClick(window.graph.view, Qt.Key_Delete)
    click(qtbot, window.line.yes)
    until(qtbot, lambda: remote.graph().nodelet("/field/tracker") is None)
    until(qtbot, window.graph.bar.undo.isEnabled)
    click(qtbot, window.graph.bar.undo)
    until(qtbot, lambda: remote.graph().nodelet("/field/tracker") is not None)
    assert topic(remote, TRACKER) == "/field/ball"


def test_context_menus_offer_what_can_be_done(qtbot, window, remote):
    view = window.graph.view
    entries = _menu(qtbot, window, view.scene().vertices["n_/nao1/bottom_camera"])
    assert not entries["D&estroy …"].isEnabled()
    entries["&Release from protection"].trigger()
    until(qtbot, lambda: not remote.graph().nodelet("/nao1/bottom_camera").is_protected)
    entries = _menu(qtbot, window, view.scene().port_item(TRACKER))
    entries["&Disconnect"].trigger()
    until(qtbot, lambda: topic(remote, TRACKER) == "")
    entries = _menu(qtbot, window, None)
    entries["&Create nodelet …"].trigger()
    assert window.tabs.currentWidget() is window.create_


def test_a_wiring_is_saved_and_loaded_and_that_is_taken_back(qtbot, window, remote, tmp_path):
    path, files = tmp_path / "wiring.xml", window.graph.files
    whole = remote.graph().nodelets
    files.save(str(path))
    until(qtbot, lambda: f"10 nodelets saved in {path}" in window.line.text)
    remote.destroy("/field/tracker")
    remote.set_config("/nao1/localization", {"field_position": "/elsewhere"})
    remote.remove_transformation("tracker")
    until(qtbot, lambda: "tracker" not in window.monitor.library)
    less = remote.graph().nodelets
    files.load(str(path))
    until(qtbot, lambda: window.line.text == "done: load wiring.xml")
    assert _wired(remote.graph().nodelets) == _wired(whole)
    click(qtbot, window.graph.bar.undo)
    until(qtbot, lambda: window.line.text == "done: undo: load wiring.xml")
    assert remote.graph().nodelets == less
    assert "tracker" not in {each.label for each in remote.library().transformations}


def test_a_wiring_that_cannot_be_loaded_changes_nothing(
    qtbot, window, remote, tmp_path, monkeypatch
):
    path, files = tmp_path / "wiring.xml", window.graph.files
    path.write_text('<wiring version="1"><nodelets><nodelet name="/x"/></nodelets></wiring>')
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *unused: (str(path), ""))
    click(qtbot, window.graph.bar.load)
    assert "wiring.xml:1: <nodelet> has no attribute transformation" in window.line.text
    files.save(str(path))
    until(qtbot, lambda: "saved" in window.line.text)
    remote.destroy("/field/tracker")
    remote.spawn("recorder", "/field/tracker")
    before = remote.graph().nodelets
    files.load(str(path))
    until(qtbot, lambda: "runs already, made from 'recorder'" in window.line.text)
    assert remote.graph().nodelets == before


# The control panel


def test_active_lists_and_destroys(qtbot, window, remote):
    table = window.active.table
    assert table.names() == sorted(each.name for each in remote.graph().nodelets)
    row = table.names().index("/nao1/subsampler")
    cells = [table.model().index(row, column).data() for column in range(6)]
    assert cells[1:5] == ["subsampler(nao1, bottom)", "1", "3", "running"]
    table.choose(["/nao1/bottom_camera"])
    assert not window.active.destroy.isEnabled()
    click(qtbot, window.active.protect)
    until(qtbot, window.active.destroy.isEnabled)
    click(qtbot, window.active.destroy)
    click(qtbot, window.line.yes)
    until(qtbot, lambda: "/nao1/bottom_camera" not in table.names())


def test_active_keeps_the_selection_while_things_change(qtbot, window, remote):
    window.active.table.choose(["/nao1/resize"])
    remote.spawn("tracker", "/a_first_one")
    until(qtbot, lambda: "/a_first_one" in window.active.table.names())
    assert window.active.table.chosen() == ["/nao1/resize"]


def test_library_shows_imports_exports_and_deletes(qtbot, window, remote, tmp_path):
    panel = window.library
    window.tabs.setCurrentWidget(panel)
    panel.table.choose(["tracker"])
    assert "<label>tracker</label>" in panel.specification.toPlainText()
    path = tmp_path / "out.xml"
    panel.export_file(str(path))
    click(qtbot, panel.delete)
    assert window.line.text == "Delete tracker from the library?"
    click(qtbot, window.line.yes)
    until(qtbot, lambda: "tracker" not in panel.table.names())
    panel.import_file(str(path))
    until(qtbot, lambda: "tracker" in panel.table.names())
    qtbot.keyClicks(panel.search, "CAM")
    assert panel.table.names() == ["camera(nao1, bottom)", "camera(nao1, top)", "ceiling_camera"]


def test_a_library_of_a_hundred_thousand_does_not_hold_up_the_window(qtbot, window):
    from dyknow.model.transformation import Transformation

    library = {f"t{i}": Transformation(f"t{i}", "p/C") for i in range(100_000)}
    window.tabs.setCurrentWidget(window.library)
    start = time.monotonic()
    window.monitor.library = library
    window.monitor.library_changed.emit(library)
    qtbot.wait(1)
    qtbot.keyClicks(window.library.search, "t99999")
    assert window.library.table.names() == ["t99999"]
    assert time.monotonic() - start < 10.0


def test_a_refused_import_shows_the_words_of_the_manager(qtbot, window, tmp_path):
    path = tmp_path / "bad.xml"
    path.write_text("<transformation>\n<label>x</label>\n<sauce>p/C</sauce></transformation>")
    window.library.import_file(str(path))
    until(qtbot, lambda: bool(window.line.text))
    assert window.line.text.startswith("import bad.xml: specification:")
    assert no_boxes()
    click(qtbot, window.line.dismiss)
    assert window.line.text == ""


def test_create_makes_a_nodelet(qtbot, window, remote):
    window.tabs.setCurrentWidget(window.create_)
    panel = window.create_
    assert not panel.create.isEnabled()
    panel.begin("tracker")
    assert panel.name.text() == "/tracker"
    panel.name.clear()
    qtbot.keyClicks(panel.name, "/field/second")
    qtbot.mouseClick(panel.is_protected, Qt.LeftButton, pos=QPoint(8, 8))
    qtbot.keyClick(panel.name, Qt.Key_Return)
    until(qtbot, lambda: "n_/field/second" in _keys(window))
    assert remote.graph().nodelet("/field/second").is_protected
    panel.begin("tracker")
    panel.name.setText("/field/second")
    click(qtbot, panel.create)
    until(qtbot, lambda: "a nodelet named '/field/second' is already" in window.line.text)
    panel.name.setText("no name")
    click(qtbot, panel.create)
    assert "'no name' is not a valid" in window.line.text


def test_connect_offers_only_what_fits(qtbot, window, remote):
    window.tabs.setCurrentWidget(window.connect_)
    panel = window.connect_
    panel.source.nodelet.setCurrentText("/field/ceiling_camera")
    sinks = {panel.sink.nodelet.itemText(i) for i in range(panel.sink.nodelet.count())}
    assert sinks == {"/field/tracker", "/nao1/localization"}
    panel.sink.nodelet.setCurrentText("/field/tracker")
    assert panel.topic_chosen.text() == "/field/ceiling_camera/field_position"
    click(qtbot, panel.connect)
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ceiling_camera/field_position")
    until(qtbot, lambda: "connected already" in panel.topic_chosen.text())
    assert not panel.connect.isEnabled()


def test_connect_takes_a_topic_by_name(qtbot, window, remote):
    window.tabs.setCurrentWidget(window.connect_)
    panel = window.connect_
    panel.begin("/field/tracker", "position")
    assert panel.now.text() == "/field/ball"
    click(qtbot, panel.disconnect_port)
    until(qtbot, lambda: panel.now.text() == "not connected")
    qtbot.keyClicks(panel.topic, "/somewhere")
    click(qtbot, panel.connect_topic)
    until(qtbot, lambda: panel.now.text() == "/somewhere")
    assert topic(remote, TRACKER) == "/somewhere"


# Streams


def _ask_for(qtbot, window, tag):
    panel = window.streams
    window.tabs.setCurrentWidget(panel)
    panel.tag.clear()
    qtbot.keyClicks(panel.tag, tag)
    return panel


def test_a_stream_is_previewed_acquired_and_released(qtbot, window, remote):
    panel = _ask_for(qtbot, window, "Track(ball)")
    before = remote.graph().nodelets
    qtbot.keyClick(panel.tag, Qt.Key_Return)
    until(qtbot, lambda: "cost 0" in panel.plan.toPlainText())
    panel.exclude.setText("tracker ; localization(nao1)")
    click(qtbot, panel.preview)
    until(qtbot, lambda: "nothing supplies Track(ball)" in panel.plan.toPlainText())
    panel.exclude.clear()
    assert remote.graph().nodelets == before and not panel.table.names()

    click(qtbot, panel.acquire)
    until(qtbot, lambda: panel.table.names() == ["claim-1"])
    assert _cells(panel.table, 0)[1:4] == ["Track(ball)", "active", "/field/tracker/track"]
    assert "Track(ball): active (requested)" in panel.events.toPlainText()
    until(qtbot, lambda: "done: acquire Track(ball): on /field/tracker/track" in window.line.text)
    panel.table.choose(["claim-1"])
    chosen = {item.vertex.name for item in window.graph.view.scene().selectedItems()}
    assert chosen == {"/field/tracker"}
    click(qtbot, panel.release)
    until(qtbot, lambda: not panel.table.names())
    panel.ended.setChecked(True)
    assert _cells(panel.table, 0)[2] == "released" and not panel.release.isEnabled()
    assert "active → released" in panel.events.toPlainText()


def test_a_stream_that_needs_new_nodelets_brings_them(qtbot, window, remote):
    remote.destroy("/field/tracker")
    panel = _ask_for(qtbot, window, "Track(ball)")
    click(qtbot, panel.preview)
    until(qtbot, lambda: "tracker.track (new, cost 1)" in panel.plan.toPlainText())
    click(qtbot, panel.acquire)
    until(qtbot, lambda: "n_/tracker" in _keys(window))
    until(qtbot, window.graph.bar.undo.isEnabled)
    click(qtbot, window.graph.bar.undo)
    until(qtbot, lambda: remote.streams()[0].state.name == "RELEASED")


def test_a_stream_that_is_not_possible_waits_and_says_for_what(qtbot, window, remote):
    panel = _ask_for(qtbot, window, "Weather(today)")
    click(qtbot, panel.acquire)
    until(qtbot, lambda: panel.table.names() == ["claim-1"])
    assert _cells(panel.table, 0)[2] == "pending"
    until(qtbot, lambda: "waits, no plan for Weather(today)" in window.line.text)
    panel = _ask_for(qtbot, window, "no term(")
    click(qtbot, panel.acquire)
    until(qtbot, lambda: "acquire no term(: " in window.line.text)
    assert panel.table.names() == ["claim-1"] and no_boxes()


def test_the_cheapest_way_is_taken_after_asking(qtbot, window, remote):
    panel = _ask_for(qtbot, window, "Track(ball)")
    click(qtbot, panel.acquire)
    until(qtbot, lambda: bool(panel.table.names()) and not window.monitor.is_changing)
    panel.table.choose(["claim-1"])
    click(qtbot, panel.replan)
    until(qtbot, lambda: "Take this way for Track(ball), at a cost of 0?" in window.line.text)
    click(qtbot, window.line.yes)
    until(qtbot, lambda: window.line.text == "done: replan Track(ball)")


# The keyboard


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
        assert {_name(each) for each in wanted - reached} == set()


def test_no_letter_is_given_twice(window):
    letters = [window.tabs.tabText(i) for i in range(window.tabs.count())]
    letters += _letters_of(window.graph.bar)
    for number in range(window.tabs.count()):
        found = letters + _letters_of(window.tabs.widget(number))
        keys = [text[text.index("&") + 1].upper() for text in found if "&" in text]
        assert sorted(keys) == sorted(set(keys)), window.tabs.tabText(number)


def test_escape_says_no(qtbot, window, remote):
    window.active.ask_to_destroy(["/field/tracker"])
    until(qtbot, window.line.yes.hasFocus)
    qtbot.keyClick(window.line.yes, Qt.Key_Escape)
    assert window.line.text == ""
    assert remote.graph().nodelet("/field/tracker") is not None


# The other side


def test_without_a_manager_the_window_waits_for_one(qtbot, window, remote):
    remote.is_up = False
    sign = window.graph.sign
    until(qtbot, lambda: "does not answer; waiting" in sign.text())
    assert sign.isVisible()
    remote.is_up = True
    until(qtbot, lambda: not sign.isVisible())


def test_a_slow_manager_does_not_hold_up_the_window(qtbot, window, remote):
    remote.delay = 3.0
    window.monitor.set_period(0.1)
    gaps = _gaps(qtbot, 1500)
    assert max(gaps) < 1.5
    remote.delay = 0.0


def test_undo_says_when_there_is_no_way_back(qtbot, window, remote):
    remote.remove_transformation("tracker")
    until(qtbot, lambda: "tracker" not in window.monitor.library)
    window.active.ask_to_destroy(["/field/tracker"])
    click(qtbot, window.line.yes)
    until(qtbot, window.graph.bar.undo.isEnabled)
    click(qtbot, window.graph.bar.undo)
    assert "cannot undo 'destroy /field/tracker'" in window.line.text
    assert not window.graph.bar.undo.isEnabled()


def test_what_cannot_be_undone_is_not_in_the_way_of_what_was_done_before(qtbot, window, remote):
    for name in ("/first", "/second"):
        create(qtbot, window, name)
    remote.destroy("/second")
    click(qtbot, window.graph.bar.undo)
    until(qtbot, lambda: "destroy /second: " in window.line.text)
    click(qtbot, window.graph.bar.undo)
    until(qtbot, lambda: window.monitor.snapshot.nodelet("/first") is None)


def test_a_manager_that_does_not_answer_keeps_what_can_be_undone(qtbot, window, remote):
    create(qtbot, window, "/first")
    remote.is_up = False
    window.monitor.undo()
    until(qtbot, lambda: "destroy /first: " in window.line.text)
    remote.is_up = True
    click(qtbot, window.graph.bar.undo)
    until(qtbot, lambda: window.monitor.snapshot.nodelet("/first") is None)


def test_a_slot_that_raises_leaves_a_line_and_a_living_window(qtbot, window, monkeypatch):
    monkeypatch.setattr(window.graph.view.scene(), "find", lambda text: 1 / 0)
    qtbot.keyClicks(window.graph.bar.search, "x")
    assert "ZeroDivisionError" in window.line.text


def test_colours_follow_the_palette(qtbot, window):
    scene = window.graph.view.scene()
    window.setPalette(dark_palette())
    until(qtbot, lambda: scene.backgroundBrush().color().lightness() < 80)
    item = scene.vertices["n_/nao1/resize"]
    assert item.colours.text.lightness() > 180
    assert item.ports["image"].colours.line.lightness() > 120
    window.setPalette(QPalette())


def test_settings_are_kept(qtbot, window, remote):
    window.graph.bar.depth.setValue(1)
    window.graph.bar.topics.setText("-/x")
    window.tabs.setCurrentIndex(2)
    other = DyKnowWidget(remote)
    qtbot.addWidget(other, before_close_func=lambda w: w.shut_down())
    other.restore({**window.state(), "period": "nonsense", "tab": "2", "parts": "1,x"})
    assert other.state()["depth"] == "1" and other.state()["topics"] == "-/x"
    assert other.state()["period"] == "1.0" and other.tabs.currentIndex() == 2


def test_five_hundred_nodelets_stay_usable(qtbot):
    remote = SimulatedRemote()
    remote.add_transformation(
        "<transformation><label>relay</label><source>p/Relay</source><ports>"
        '<port type="in">in</port><port type="out">out</port></ports></transformation>'
    )
    for i in range(500):
        group, place = divmod(i, 10)
        before = f"/g{group}/t{place - 1}" if place else f"/g{group - 1}/t9" if group else ""
        remote.spawn("relay", f"/g{group}/n{place}", {"in": before, "out": f"/g{group}/t{place}"})
    widget = DyKnowWidget(remote)
    qtbot.addWidget(widget, before_close_func=lambda w: w.shut_down())
    widget.resize(1400, 800)
    widget.show()
    widget.start()
    worst = max(_gaps(qtbot, 30000, lambda: len(widget.graph.drawn.vertices) == 1000))
    assert len(widget.graph.drawn.vertices) == 1000
    assert worst < 3.0, worst
    remote.set_config("/g7/n3", {"in": "/elsewhere"})
    worst = max(_gaps(qtbot, 30000, lambda: "t_/elsewhere" in _keys(widget)))
    assert "t_/elsewhere" in _keys(widget)
    assert worst < 3.0, worst
    for i in range(100):
        remote.spawn("relay", f"/more/n{i}", {"in": f"/more/t{i}", "out": f"/more/t{i + 1}"})
    worst = max(_gaps(qtbot, 30000, lambda: "n_/more/n99" in _keys(widget)))
    zoom = widget.graph.view.zoom
    assert "n_/more/n99" in _keys(widget)
    assert worst < 3.0, worst
    widget.graph.bar.nodelets.setText("/g7")
    until(qtbot, lambda: widget.graph.view.zoom > 3 * zoom)


def test_without_graphviz_there_is_still_a_drawing(qtbot, window):
    figure = window.graph.drawn
    from dyknow_rqt.canvas.appearance import sizes_of

    sizes = sizes_of(figure, window.font())
    for layouter in (Layouter("no_such_program"), Layouter("dot", limit=0.0)):
        words = []
        layouter.failed.connect(words.append)
        with qtbot.waitSignal(layouter.ready, timeout=20_000) as signal:
            layouter.lay_out(figure, sizes)
        assert set(signal.args[2].centres) == {vertex.key for vertex in figure.vertices}
        layouter.close()
    assert len(words) <= 1


# Help


def _keys(window):
    return set(window.graph.view.scene().vertices)


def _cells(table, row):
    model = table.model()
    return [model.index(row, column).data() for column in range(model.columnCount())]


def _letters_of(widget):
    kinds = (QAbstractButton, QLabel)
    return [each.text() for kind in kinds for each in widget.findChildren(kind)]


def _name(widget):
    return type(widget).__name__, widget.accessibleName(), getattr(widget, "text", str)()


def _wired(nodelets):
    return [(n.name, n.transformation, [(p.name, p.topic) for p in n.ports]) for n in nodelets]


def _menu(qtbot, window, item):
    window.graph.view.menu_wanted.emit(item, QPoint(50, 50))
    menu = next(menu for menu in window.graph.findChildren(QMenu) if menu.isVisible())
    entries = {action.text(): action for action in menu.actions()}
    menu.hide()
    return entries


def _gaps(qtbot, most, until=lambda: False):
    """Pauses (s) between ticks of the window's own clock, for some time (ms)."""
    ticks = [time.monotonic()]
    timer = QTimer()
    timer.timeout.connect(lambda: ticks.append(time.monotonic()))
    timer.start(10)
    end = time.monotonic() + most / 1000
    while time.monotonic() < end and not until():
        qtbot.wait(20)
    timer.stop()
    return [b - a for a, b in zip(ticks, ticks[1:])]
