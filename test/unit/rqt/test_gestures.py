# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Changes made in the graph: drags, keys, menus, whole wirings."""

from __future__ import annotations

from python_qt_binding.QtCore import QPoint, Qt
from python_qt_binding.QtWidgets import QFileDialog
from unit.rqt.hands import (
    CEILING,
    HSV_IN,
    TRACKER,
    centre_of,
    click,
    context_menu,
    drag,
    move,
    no_boxes,
    topic,
    until,
    wiring_of,
)

from dyknow.model.graph import PortRef


def test_a_drag_from_port_to_port_connects_and_undo_takes_it_back(qtbot, window, remote):
    view = window.graph.view
    drag(view, view.place_of(CEILING), view.place_of(TRACKER))
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ceiling_camera/field_position")
    until(qtbot, window.graph.bar.undo.isEnabled)
    view.setFocus()
    qtbot.keyClick(view, Qt.Key_Z, Qt.ControlModifier)
    until(qtbot, lambda: (topic(remote, TRACKER), topic(remote, CEILING)) == ("/field/ball", ""))
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


def test_a_drag_says_its_type_and_what_it_replaces(qtbot, window, remote):
    view = window.graph.view
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


def test_delete_disconnects_arrows_and_destroys_nodelets_after_asking(qtbot, window, remote):
    scene = window.graph.view.scene()
    arrow = next(e for e in scene.edges if e.head == "n_/field/tracker")
    scene.edges[arrow].setSelected(True)
    qtbot.keyClick(window.graph.view, Qt.Key_Delete)
    until(qtbot, lambda: topic(remote, TRACKER) == "")
    until(qtbot, window.graph.bar.undo.isEnabled)
    click(qtbot, window.graph.bar.undo)
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ball")
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
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ball")


def test_context_menus_offer_what_can_be_done(qtbot, window, remote):
    view = window.graph.view
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
    click(qtbot, window.graph.bar.undo)
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
