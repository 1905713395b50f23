# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The graph, used as a person uses it: pointer, wheel, filters, search, and the drawing."""

from __future__ import annotations

from types import SimpleNamespace

import pydot
import pytest
from python_qt_binding.QtCore import QPoint, Qt, QTimer
from python_qt_binding.QtGui import QImage
from python_qt_binding.QtWidgets import QFileDialog, QLineEdit
from unit.rqt.hands import centre_of, drag, turn_wheel, until, vertex_keys

from dyknow.model.graph import NodeletKind, PortRef
from dyknow_rqt.graph.snapshot import Snapshot
from dyknow_rqt.graph_panel.files import save_drawing


def test_the_wheel_zooms_where_the_pointer_is(qtbot, view):
    place = centre_of(view, "n_/nao1/localization")
    qtbot.mouseMove(view.viewport(), place)
    before, zoom = view.mapToScene(place), view.zoom
    turn_wheel(view.viewport(), place, 240)
    assert view.zoom > zoom * 1.3
    assert (view.mapFromScene(before) - place).manhattanLength() <= 2


def test_a_drag_on_the_ground_moves_the_view(qtbot, view):
    ground = QPoint(20, view.viewport().height() - 20)
    qtbot.mouseClick(view.viewport(), Qt.LeftButton, Qt.NoModifier, ground)
    assert not view.is_chosen, "a click keeps it fitting"
    before = view.mapToScene(0, 0)
    drag(view, ground, ground + QPoint(60, -40))
    after = view.mapToScene(0, 0)
    assert after.x() < before.x() and after.y() > before.y() and view.is_chosen


def test_filters_hide_and_complain(qtbot, window):
    edit = window.graph.bar.nodelets
    qtbot.keyClicks(edit, "/nao1, -/nao1/.*camera")
    until(qtbot, lambda: "n_/field/tracker" not in vertex_keys(window))
    assert "n_/nao1/resize" in vertex_keys(window)
    assert "n_/nao1/top_camera" not in vertex_keys(window)
    edit.clear()
    until(qtbot, lambda: "n_/field/tracker" in vertex_keys(window))
    qtbot.keyClicks(edit, "/nao[")
    assert "filter '/nao[' is not a regular expression" in window.line.text
    assert "n_/field/tracker" in vertex_keys(window)
    qtbot.keyClicks(edit, "12]")
    assert window.line.text == ""
    until(qtbot, lambda: "n_/field/tracker" not in vertex_keys(window))


def test_options_change_what_is_drawn(qtbot, window, remote):
    bar, readers = window.graph.bar, remote.subscribers
    remote.subscribers = {}
    bar.choose("dead_sinks", 1)
    until(qtbot, lambda: "t_/field/tracker/track" not in vertex_keys(window))
    remote.subscribers = readers  # with its reader the topic is not a dead sink
    bar.choose("nodes", 1)
    until(qtbot, lambda: "p_/team_view" in vertex_keys(window))
    bar.choose("mode", 1)
    until(qtbot, lambda: not any(key.startswith("t_") for key in vertex_keys(window)))
    bar.choose("depth", 0)
    until(qtbot, lambda: window.graph.drawn.groups() == [])


def test_find_selects_one_after_the_other_and_arrow_keys_walk_on(qtbot, window, view):
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
    view.select(view.scene().vertices["n_/nao1/top_camera"])
    seen = []
    for _ in range(2):
        qtbot.keyClick(view, Qt.Key_Right)
        seen += [item.vertex.name for item in view.scene().selectedItems()]
    assert seen == ["/nao1/top_camera/yuv", "/nao1/resize"]


def test_the_drawing_can_be_saved(window, tmp_path):
    for name in ("graph.dot", "graph.svg", "graph.png"):
        save_drawing(window.graph.view.scene(), str(tmp_path / name))
    (graph,) = pydot.graph_from_dot_file(str(tmp_path / "graph.dot"))
    assert {box.get_name() for box in graph.get_subgraphs()} == {
        '"cluster_/field"',
        '"cluster_/nao1"',
    }
    assert len(graph.get_edges()) == len(window.graph.drawn.edges)
    svg = (tmp_path / "graph.svg").read_text()
    assert "ball_detector" in svg or "<path" in svg
    image = QImage(str(tmp_path / "graph.png"))
    assert image.width() > image.height() > 100
    with pytest.raises(OSError):
        save_drawing(window.graph.view.scene(), str(tmp_path / "nowhere" / "graph.png"))


def test_a_name_without_an_ending_gets_that_of_what_was_chosen(qtbot, window, tmp_path):
    def answer():
        found = window.findChildren(QFileDialog)
        found[0].findChild(QLineEdit).setText(str(tmp_path / "graph"))
        found[0].accept()

    QTimer.singleShot(300, answer)
    next(a for a in window.graph.bar.save_menu.actions() if "PNG" in a.text()).trigger()
    assert [path.name for path in tmp_path.iterdir()] == ["graph.png"]
    assert not QImage(str(tmp_path / "graph.png")).isNull()


def test_a_tool_tip_names_the_transports_of_what_is_under_the_pointer(
    qtbot, window, remote, scene
):
    node = window.monitor.snapshot.nodelet("/nao1/subsampler").node
    topic = "/nao1/subsampler/hsv"
    remote.connected = {
        (node, "out", topic): ["SHMROS", "TCPROS", "SHMROS"],
        (node, "in", topic): ["TCPROS"],
        ("/other", "out", topic): ["UDPROS"],
    }
    arrow = next(e for e in scene.edges if e.tail == "n_/nao1/subsampler" and e.topic == topic)
    asked = []
    scene.transports_wanted.connect(asked.append)
    for item in (
        scene.vertices[f"t_{topic}"],
        scene.edges[arrow],
        scene.port_item(PortRef("/nao1/subsampler", "hsv")),
    ):
        scene.set_transports({})
        assert scene.facts.tip_of(item).endswith("connections: 1 within the process")
        place = item.path.pointAtPercent(0.5) if item is scene.edges[arrow] else item.scenePos()
        event = SimpleNamespace(
            scenePos=lambda place=place: place, screenPos=QPoint, widget=lambda: window
        )
        scene.helpEvent(event)
        words = "connections: 2 SHMROS, 1 TCPROS, 1 within the process"
        until(qtbot, lambda item=item, words=words: scene.facts.tip_of(item).endswith(words))
    assert "sensor_msgs/Image" in scene.facts.tip_of(item)
    assert "HSV(?robot, ?camera)" in scene.facts.tip_of(item)
    assert asked == [{node}] * 3  # and no other node is queried, ever
    assert "connections" not in scene.facts.tip_of(scene.vertices["n_/nao1/subsampler"])


@pytest.mark.parametrize("kind", NodeletKind)
def test_the_badge_of_another_language_is_for_c_plus_plus(qtbot, window, remote, scene, kind):
    remote.client.alter("/nao1/resize", kind=kind, detail="altered")
    until(qtbot, lambda: window.monitor.snapshot.nodelet("/nao1/resize").detail)
    item = scene.vertices["n_/nao1/resize"]
    until(qtbot, lambda: item.shown is not None and item.shown.detail)
    assert item._badge() == ("C++" if "C++" in kind.title else "")


def test_states_are_told_apart(window, scene):
    vertices = scene.vertices
    for key, badge in (
        ("n_/nao1/bottom_camera", "protected"),
        ("n_/nao1/resize", "C++"),
        ("n_/nao1/recorder", "lost"),
        ("n_/field/ceiling_camera", "failed"),
        ("n_/field/tracker", ""),
    ):
        assert vertices[key]._badge() == badge, key
    item = vertices["n_/field/ceiling_camera"]
    assert "no device /dev/video4" in scene.facts.tip_of(item)
    for snapshot, badge in ((Snapshot(), ""), (window.monitor.snapshot, "failed")):
        scene.facts.take(snapshot)  # it goes, and is back
        scene.facts.show_vertex(item)
        assert item._badge() == badge


def test_the_view_does_not_jump_when_something_comes(qtbot, window, remote, view):
    before = {key: item.pos() for key, item in view.scene().vertices.items()}
    corner, zoom = view.mapToScene(0, 0), view.zoom
    remote.client.spawn(
        "tracker", "/nao1/second_tracker", {"position": "/nao1/ball_detector/ball"}
    )
    until(qtbot, lambda: "n_/nao1/second_tracker" in vertex_keys(window))
    after = view.scene().vertices
    moved = [k for k, place in before.items() if (after[k].pos() - place).manhattanLength() > 16]
    assert len(moved) <= 4
    assert (view.mapToScene(0, 0) - corner).manhattanLength() < 2 and view.zoom == zoom


def test_what_comes_is_seen_until_hands_choose_the_view(qtbot, window, remote, view):
    def is_seen():
        seen = view.mapToScene(view.viewport().rect()).boundingRect()
        return seen.contains(view.scene().drawing_area())

    for number in range(12):
        remote.client.spawn("tracker", f"/more{number}")
    until(qtbot, lambda: "n_/more11" in vertex_keys(window) and is_seen())
    qtbot.keyClick(view, Qt.Key_Plus)
    corner = view.mapToScene(0, 0)
    for number in range(12, 40):
        remote.client.spawn("tracker", f"/more{number}")
    until(qtbot, lambda: "n_/more39" in vertex_keys(window))
    assert (view.mapToScene(0, 0) - corner).manhattanLength() < 2
    assert not is_seen()
    view.fit()
    window.resize(900, 600)
    until(qtbot, is_seen)
