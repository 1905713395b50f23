# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Changes made in the graph by drags, keys and menus; one selection for graph, tables and all."""

from __future__ import annotations

from python_qt_binding.QtCore import QEvent, QPoint, Qt
from python_qt_binding.QtGui import QGuiApplication
from python_qt_binding.QtWidgets import QApplication, QFileDialog, QMenu
from unit.rqt.hands import (
    CEILING,
    HSV_IN,
    TRACKER,
    centre_of,
    click,
    context_menu,
    drag,
    is_ready,
    is_settled,
    move,
    no_boxes,
    topic,
    undo,
    until,
    vertex_keys,
    wiring_of,
)

from dyknow.model.graph import PortRef
from dyknow_rqt import background_calls
from dyknow_rqt.graph.figure import VertexKind


def test_a_drag_from_port_to_port_connects_and_undo_takes_it_back(qtbot, window, remote, view):
    drag(view, view.place_of(CEILING), view.place_of(TRACKER))
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ceiling_camera/field_position")
    until(qtbot, window.graph.bar.undo.isEnabled)
    view.setFocus()
    qtbot.keyClick(view, Qt.Key_Z, Qt.ControlModifier)
    until(qtbot, lambda: (topic(remote, TRACKER), topic(remote, CEILING)) == ("/field/ball", ""))
    until(qtbot, window.graph.bar.redo.isEnabled)
    click(qtbot, window.graph.bar.redo)
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ceiling_camera/field_position")


def test_while_a_connection_is_drawn_only_what_fits_is_offered(view):
    view.drag_began.emit(CEILING)
    offered = {
        port.ref
        for item in view.scene().vertices.values()
        for port in item.ports.values()
        if port.offered
    }
    assert offered == {CEILING, TRACKER, PortRef("/nao1/localization", "objects")}


def test_a_drag_says_its_type_and_what_it_replaces(qtbot, window, remote, view):
    lines = view.wire.text
    qtbot.mousePress(view.viewport(), Qt.LeftButton, Qt.NoModifier, view.place_of(CEILING))
    assert lines() == "geometry_msgs/PointStamped"
    said = {}
    for what, place in (
        ("fits", view.place_of(TRACKER)),
        ("does not", view.place_of(HSV_IN)),
        ("other topic", centre_of(view, "t_/nao1/joint_states")),
        ("topic", centre_of(view, "t_/field/ball")),
        ("ground", QPoint(5, 5)),
    ):
        move(view, place)
        said[what] = lines().split("\n")
        assert view.viewport().rect().contains(view.wire.geometry())
    assert said["fits"] == [
        "geometry_msgs/PointStamped",
        "to /field/tracker:position",
        "over /field/ceiling_camera/field_position",
        "replaces /field/ball at /field/tracker:position",
    ]
    assert "'/nao1/line_detector:hsv' expects sensor_msgs/Image" in said["does not"][0]
    assert "/nao1/joint_states carries sensor_msgs/JointState" in said["other topic"][0]
    assert said["topic"] == ["geometry_msgs/PointStamped", "to /field/ball"]
    assert said["ground"] == ["geometry_msgs/PointStamped"]
    qtbot.mouseRelease(view.viewport(), Qt.LeftButton, Qt.NoModifier, QPoint(5, 5))
    assert not view.wire.isVisible() and topic(remote, CEILING) == ""
    fitting = "/field/tracker:position, /nao1/localization:objects"
    words = f"{CEILING} is not connected: end the arrow at a port that fits ({fitting}"
    assert window.line.text.startswith(words) and window.line.text.endswith("or at a topic")
    drag(view, view.place_of(CEILING), view.place_of(HSV_IN))
    assert "'/nao1/line_detector:hsv' expects sensor_msgs/Image" in window.line.text
    assert topic(remote, CEILING) == "" and no_boxes()
    drag(view, view.place_of(CEILING), centre_of(view, "t_/field/ball"))
    until(qtbot, lambda: topic(remote, CEILING) == "/field/ball")


def test_a_press_without_the_release_of_the_one_before_draws_one_line(qtbot, view, scene):
    count, place = len(scene.items()), view.place_of(CEILING)
    for _ in range(2):
        qtbot.mousePress(view.viewport(), Qt.LeftButton, Qt.NoModifier, place)
    assert len(scene.items()) == count + 1
    qtbot.mouseRelease(view.viewport(), Qt.LeftButton, Qt.NoModifier, place)
    assert len(scene.items()) == count


def test_an_arrow_of_an_ordinary_node_is_not_disconnected(qtbot, window, remote, caplog):
    view, before = window.graph.view, wiring_of(remote.graph().nodelets)
    window.graph.bar.choose("nodes", 1)
    until(qtbot, lambda: any(edge.head == "p_/team_view" for edge in view.scene().edges))
    arrow = next(each for edge, each in view.scene().edges.items() if edge.head == "p_/team_view")
    arrow.setSelected(True)
    qtbot.keyClick(view, Qt.Key_Delete)
    view.scene().vertices["n_/field/tracker"].setSelected(True)
    assert context_menu(qtbot, window, arrow)["&Disconnect 2 ports"].isEnabled()
    assert wiring_of(remote.graph().nodelets) == before and not caplog.records


def test_delete_disconnects_arrows_and_destroys_nodelets_after_asking(
    qtbot, window, remote, scene
):
    arrow = next(e for e in scene.edges if e.head == "n_/field/tracker")
    scene.edges[arrow].setSelected(True)
    qtbot.keyClick(window.graph.view, Qt.Key_Delete)
    until(qtbot, lambda: topic(remote, TRACKER) == "")
    undo(qtbot, window)
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ball")
    window.graph.view.select(window.graph.view.scene().vertices["n_/field/tracker"])
    qtbot.keyClick(window.graph.view, Qt.Key_Delete)
    assert window.line.text == "Destroy /field/tracker?"
    click(qtbot, window.line.no)
    assert remote.graph().nodelet("/field/tracker") is not None
    qtbot.keyClick(window.graph.view, Qt.Key_Delete)
    click(qtbot, window.line.yes)
    until(qtbot, lambda: remote.graph().nodelet("/field/tracker") is None)
    undo(qtbot, window)
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ball")


def test_context_menus_offer_what_can_be_done(qtbot, window, remote, view):
    entries = context_menu(qtbot, window, view.scene().vertices["n_/nao1/bottom_camera"])
    assert not entries["D&estroy …"].isEnabled()
    entries["&Release from protection"].trigger()
    until(qtbot, lambda: not remote.graph().nodelet("/nao1/bottom_camera").is_protected)
    until(qtbot, lambda: not window.monitor.is_changing)
    entries = context_menu(qtbot, window, view.scene().port_item(TRACKER))
    entries["&Disconnect"].trigger()
    until(qtbot, lambda: topic(remote, TRACKER) == "")
    entries = context_menu(qtbot, window, None)
    window.graph.bar.panel.trigger()
    assert not window.tabs.isVisible()
    entries["&Create nodelet …"].trigger()
    assert window.tabs.currentWidget() is window.create_ and window.create_.isVisible()
    window.graph.bar.panel.trigger()
    window.graph.edits.connection_wanted.emit("/field/tracker", "")
    assert window.connect_.isVisible() and window.graph.bar.panel.isChecked()


def test_a_wiring_is_saved_and_loaded_and_that_is_taken_back(qtbot, window, remote, tmp_path):
    path, files = tmp_path / "wiring.xml", window.graph.files
    whole = remote.graph().nodelets
    files.save(str(path))
    until(qtbot, lambda: f"10 nodelets saved in {path}" in window.line.text)
    remote.client.destroy("/field/tracker")
    remote.client.set_config("/nao1/localization", {"field_position": "/elsewhere"})
    remote.client.remove_transformation("tracker")
    until(qtbot, lambda: "tracker" not in window.monitor.library)
    less = remote.graph().nodelets
    files.load(str(path))
    until(qtbot, lambda: window.line.text == "done: load wiring.xml")
    assert wiring_of(remote.graph().nodelets) == wiring_of(whole)
    undo(qtbot, window)
    until(qtbot, lambda: window.line.text == "done: undo 'load wiring.xml'")
    assert remote.graph().nodelets == less
    assert "tracker" not in {each.label for each in remote.client.get_model().transformations}


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
    remote.client.destroy("/field/tracker")
    remote.client.spawn("recorder", "/field/tracker")
    before = remote.graph().nodelets
    files.load(str(path))
    until(qtbot, lambda: "runs already, made from 'recorder'" in window.line.text)
    assert remote.graph().nodelets == before


OTHER_TRACKER = (
    "<transformation><label>other_tracker</label><source>soccer/OtherTracker</source><ports>"
    '<port type="in" datatype="geometry_msgs/PointStamped">position</port>'
    '<port type="out" datatype="nav_msgs/Path">track</port></ports><tags>'
    '<tag port="position">FieldPosition(ball)</tag><tag port="track">Track(ball)</tag></tags>'
    "</transformation>"
)
THREE = ["/field/tracker", "/nao1/resize", "/nao1/subsampler"]


def drawn_selection(window):
    scene = window.graph.view.scene()
    items = (*scene.vertices.items(), *scene.edges.items())
    return {key for key, item in items if item.isSelected()}


def click_on(qtbot, window, key, modifiers=Qt.NoModifier):
    view = window.graph.view
    qtbot.mouseClick(view.viewport(), Qt.LeftButton, modifiers, centre_of(view, key))


def test_the_table_and_the_graph_select_the_same(qtbot, window):
    table = window.active.table
    table.choose(THREE)
    assert drawn_selection(window) == {f"n_{name}" for name in THREE}
    click_on(qtbot, window, "n_/nao1/localization")
    assert table.chosen() == ["/nao1/localization"] == window.selection.nodelets
    click_on(qtbot, window, "n_/nao1/resize", Qt.ControlModifier)
    assert table.chosen() == ["/nao1/localization", "/nao1/resize"]
    click_on(qtbot, window, "t_/field/ball")
    assert table.chosen() == [] and drawn_selection(window) == {"t_/field/ball"}
    assert not window.active.destroy.isEnabled()
    row = table.names().index("/nao1/resize")
    place = table.visualRect(table.model().index(row, 0)).center()
    qtbot.mouseClick(table.viewport(), Qt.LeftButton, Qt.NoModifier, place)
    assert drawn_selection(window) == {"n_/nao1/resize"}


def test_what_is_selected_between_two_slices_of_a_drawing_stays_selected(
    qtbot, window, monkeypatch, scene
):
    while scene.slices._steps:
        scene.slices.go_on()
    monkeypatch.setattr(background_calls, "SLICE", -1.0)  # each step is one
    scene.show_drawing(scene._drawing)
    window.graph.view.select(scene.vertices["n_/field/tracker"])
    assert scene.slices.is_wanted(scene._draw) and window.selection.nodelets == ["/field/tracker"]
    until(qtbot, lambda: is_settled(window))
    assert drawn_selection(window) == {"n_/field/tracker"}
    assert window.selection.nodelets == ["/field/tracker"]


def test_what_is_hidden_stays_selected_in_the_table_and_an_arrow_does_not(qtbot, window, scene):
    arrow = next(e for e in scene.edges if e.head == "n_/field/tracker")
    window.selection.choose({"n_/field/tracker", "t_/field/ball", arrow})
    assert drawn_selection(window) == {"n_/field/tracker", "t_/field/ball", arrow}
    window.graph.bar.nodelets.setText("/nao1")
    until(qtbot, lambda: "n_/field/tracker" not in vertex_keys(window))
    assert window.active.table.chosen() == ["/field/tracker"]
    until(qtbot, lambda: window.selection.edges == [])
    window.graph.bar.nodelets.clear()
    until(qtbot, lambda: "n_/field/tracker" in drawn_selection(window))


def test_the_way_to_what_is_in_a_collapsed_box_leads_to_that(qtbot, window, view, scene):
    window.graph.bar.collapse([("/nao1",)])
    until(qtbot, lambda: "b_/nao1" in vertex_keys(window) and is_settled(window))
    view.zoom_by(6)
    view.centerOn(scene.vertices["n_/field/ceiling_camera"])
    window.health.lead("lost")
    box = scene.vertices["b_/nao1"]
    assert view.seen.contains(box.sceneBoundingRect()) and drawn_selection(window) == {"b_/nao1"}
    assert window.selection.nodelets == ["/nao1/recorder"] == window.active.table.chosen()
    assert not context_menu(qtbot, window, box)["Copy &names"].isEnabled()
    assert not window.selection.nodelets, "the menu is that of the box alone"


def test_the_way_to_what_is_hidden_says_so(qtbot, window):
    window.graph.bar.nodelets.setText("/field")
    until(qtbot, lambda: "n_/nao1/recorder" not in vertex_keys(window))
    window.health.lead("lost")
    assert "nothing of the selection is drawn" in window.line.text


def test_what_is_gone_is_not_selected(qtbot, window, remote):
    window.active.table.choose(THREE)
    remote.client.destroy("/nao1/resize")
    until(qtbot, lambda: "n_/nao1/resize" not in vertex_keys(window))
    assert window.selection.nodelets == ["/field/tracker", "/nao1/subsampler"]
    assert window.active.table.chosen() == window.selection.nodelets


def test_the_menu_is_for_all_that_is_selected(qtbot, window, remote):
    window.active.table.choose(THREE)
    vertices = window.graph.view.scene().vertices
    entries = context_menu(qtbot, window, vertices["n_/nao1/resize"])
    assert "&Connect …" not in entries
    assert "&Disconnect 7 ports" in entries
    entries["Copy &names"].trigger()
    assert QGuiApplication.clipboard().text().split() == THREE
    entries["&Protect 3 nodelets"].trigger()

    def protected():
        return [remote.graph().nodelet(name).is_protected for name in THREE]

    until(qtbot, lambda: all(protected()))
    until(qtbot, lambda: not window.monitor.is_changing)
    until(qtbot, lambda: window.monitor.snapshot.nodelet(THREE[-1]).is_protected)
    entries = context_menu(qtbot, window, vertices["n_/nao1/resize"])
    assert not entries["D&estroy 3 nodelets …"].isEnabled()
    entries["&Release 3 nodelets from protection"].trigger()
    until(qtbot, lambda: not any(protected()))
    until(qtbot, lambda: not window.monitor.is_changing)
    until(qtbot, lambda: not window.monitor.snapshot.nodelet(THREE[-1]).is_protected)
    context_menu(qtbot, window, vertices["n_/nao1/resize"])["D&estroy 3 nodelets …"].trigger()
    assert window.line.text == f"Destroy {', '.join(THREE)}?"
    window.line.yes.click()
    until(qtbot, lambda: not set(THREE) & {each.name for each in remote.graph().nodelets})


def test_the_menu_of_something_else_selects_that_and_the_table_has_the_same(qtbot, window, remote):
    window.active.table.choose(THREE)
    entries = context_menu(qtbot, window, window.graph.view.scene().vertices["t_/field/ball"])
    assert window.selection.keys == {"t_/field/ball"} and window.active.table.chosen() == []
    assert entries["&Disconnect all ports"].isEnabled()
    assert window.selection.names(VertexKind.TOPIC) == ["/field/ball"]
    window.active.table.choose(["/field/tracker"])
    window.active.table.customContextMenuRequested.emit(QPoint(5, 5))
    menu = next(menu for menu in window.graph.findChildren(QMenu) if menu.isVisible())
    next(a for a in menu.actions() if a.text() == "&Disconnect all ports").trigger()
    menu.hide()
    until(qtbot, lambda: topic(remote, TRACKER) == "")


def test_the_nodelets_of_a_stream_are_those_after_a_repair(qtbot, window, remote):
    client = remote.client
    client.destroy("/field/tracker")
    window.tabs.setCurrentWidget(window.streams)
    window.streams.tag.setText("Track(ball)")
    # Not while it seems silent on a busy machine.
    until(qtbot, lambda: is_ready(window))
    window.streams.acquire.click()
    until(qtbot, lambda: "n_/tracker_1" in vertex_keys(window))
    until(qtbot, lambda: len(window.streams.table.names()) == 1)
    window.streams.table.choose(window.streams.table.names())
    assert "/tracker_1" in window.selection.nodelets
    assert "/tracker_1" in window.active.table.chosen()
    client.add_transformation(OTHER_TRACKER)
    client.remove_transformation("tracker")
    client.host.vanish("/tracker_1")
    client.settle()
    (stream,) = client.list_streams()
    assert "/other_tracker_1" in stream.nodelets and "/tracker_1" not in stream.nodelets
    until(qtbot, lambda: window.selection.nodelets == sorted(stream.nodelets))
    until(qtbot, lambda: "n_/other_tracker_1" in drawn_selection(window))
    assert "/other_tracker_1" in window.active.table.chosen()
    assert window.selection.claims == {stream.claim_id} == set(window.streams.table.chosen())
    click_on(qtbot, window, "n_/nao1/resize")
    assert window.streams.table.chosen() == [] and not window.streams.release.isEnabled()
    assert window.selection.nodelets == ["/nao1/resize"]


def test_highlights_go_with_what_was_highlighted(qtbot, window, remote, view, scene):
    def tones():
        items = (*scene.vertices.values(), *scene.edges.values())
        return {item.tone.value for item in items} - {"none"}

    qtbot.mouseMove(view.viewport(), centre_of(view, "n_/nao1/resize"))
    until(qtbot, lambda: scene.vertices["n_/nao1/resize"].tone.value == "self")
    assert scene.vertices["t_/nao1/top_camera/yuv"].tone.value == "in"
    assert scene.vertices["t_/nao1/preview"].tone.value == "out"
    assert tones() == {"self", "in", "out"}
    remote.client.set_config("/nao1/resize", {"resized": ""})
    until(qtbot, lambda: tones() == {"self", "in"})
    remote.client.set_config("/nao1/resize", {"resized": "/nao1/top_camera/yuv"})
    until(qtbot, lambda: scene.vertices["t_/nao1/top_camera/yuv"].tone.value == "both")
    remote.client.destroy("/nao1/resize")
    until(qtbot, lambda: "n_/nao1/resize" not in vertex_keys(window))
    assert tones() == set()
    scene.highlight(next(iter(scene.edges)))
    assert tones() == {"self", "in", "out"}
    QApplication.sendEvent(view, QEvent(QEvent.Leave))
    assert tones() == set()
