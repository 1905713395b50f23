# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Editing in the drawing: moved nodelets, wires that make or splice, parameters and restarts."""

from __future__ import annotations

import gc
import json

import pytest
from python_qt_binding.QtCore import QPoint, Qt
from python_qt_binding.QtTest import QTest
from python_qt_binding.QtWidgets import QMenu
from unit.rqt.hands import (
    CEILING,
    TRACKER,
    centre_of,
    click,
    context_menu,
    drag,
    is_settled,
    move,
    topic,
    undo,
    until,
    vertex_keys,
    window_of,
)

from dyknow.model.graph import PortRef
from dyknow_rqt.graph.figure import Edge
from dyknow_rqt.graph.geometry import Places, Point
from dyknow_rqt.graph.snapshot import Snapshot
from dyknow_rqt.graph.wiring import splice
from dyknow_rqt.panels.create import ParametersDialog

MOVED, RESIZE = "n_/nao1/resize", PortRef("/nao1/resize", "image")
YUV = "/nao1/top_camera/yuv"


def place_of(window, key):
    at = window.graph.view.scene().vertices[key].pos()
    return Point(at.x(), at.y())


def wait_for_drawing(qtbot, window):
    until(qtbot, lambda: is_settled(window))


def press_menu(window, text):
    menu = next(each for each in window.graph.findChildren(QMenu) if each.isVisible())
    action = next(each for each in menu.actions() if text in each.text())
    action.trigger()
    menu.close()


# Moving


@pytest.fixture(params=[0, 2], ids=["to the right", "downwards"])
def flowing(request, qtbot, window):
    """The window, with streams that flow to one of two sides."""
    window.graph.bar.choose("direction", request.param)
    until(qtbot, lambda: window.graph.drawn.is_downwards is bool(request.param))
    wait_for_drawing(qtbot, window)
    return window


def test_a_nodelet_is_moved_with_its_arrows_and_box_and_stays(qtbot, flowing, remote, scene):
    window, view = flowing, flowing.graph.view
    others = {key: place_of(window, key) for key in scene.vertices if key != MOVED}
    start = centre_of(view, MOVED)
    end = start + QPoint(30, 60)
    port = view.viewport()
    QTest.mousePress(port, Qt.LeftButton, Qt.NoModifier, start)
    move(view, (start + end) / 2)
    move(view, end)
    item = scene.vertices[MOVED]
    assert (view.mapFromScene(item.pos()) - end).manhattanLength() <= 2
    arrow = next(e for e in scene.edges if e.head == MOVED)
    tip = scene.edges[arrow].path.currentPosition()
    assert (tip - item.anchor("image", leaving=False)).manhattanLength() < 1
    box = scene.boxes[("/nao1",)].area
    assert box.contains(item.area.translated(item.pos()))
    QTest.mouseRelease(port, Qt.LeftButton, Qt.NoModifier, end)
    put = place_of(window, MOVED)
    wait_for_drawing(qtbot, window)
    assert window.graph.edits.places.present == {MOVED: put} and place_of(window, MOVED) == put
    remote.client.spawn("tracker", "/other/tracker", {})
    until(qtbot, lambda: "n_/other/tracker" in scene.vertices)
    wait_for_drawing(qtbot, window)
    assert place_of(window, MOVED) == put
    assert {key: place_of(window, key) for key in others} == others
    tip = scene.edges[arrow].path.currentPosition()
    assert (tip - item.anchor("image", leaving=False)).manhattanLength() < 1
    assert not window.graph.card.isVisible()


def test_a_nodelet_is_moved_while_a_changed_graph_is_being_drawn(qtbot, window, remote):
    scene, ready = window.graph.view.scene(), []
    window.graph.layouter.ready.disconnect()
    window.graph.layouter.ready.connect(ready.append)
    remote.client.spawn("tracker", "/new/tracker", {})
    until(qtbot, lambda: ready and "n_/new/tracker" in ready[-1].layout.centres)
    scene._drawing = ready[-1]
    steps = scene._draw()
    while "n_/new/tracker" not in scene.vertices:
        next(steps)
    before = scene.vertices[MOVED].pos()
    scene.move({MOVED: before}, QPoint(5, 5))
    assert scene.vertices[MOVED].pos() == before + QPoint(5, 5)
    list(steps)
    assert ("/new",) in scene.boxes


def test_places_are_kept_with_the_settings_until_the_graph_is_tidied(qtbot, window, remote):
    drag(window.graph.view, centre_of(window.graph.view, MOVED), QPoint(200, 300))
    put, state = place_of(window, MOVED), window.state()
    another = window_of(qtbot, remote)
    another.restore(state)
    until(qtbot, lambda: MOVED in another.graph.view.scene().vertices)
    wait_for_drawing(qtbot, another)
    assert place_of(another, MOVED) == put
    click(qtbot, another.graph.bar.tidy)
    until(qtbot, lambda: place_of(another, MOVED) != put)
    assert another.state()["places"] == ""


def test_a_rubber_band_selects_what_is_moved_together(window, view):
    scene, port = view.scene(), view.viewport()
    ends = [scene.vertices[key].sceneBoundingRect() for key in (MOVED, "n_/nao1/recorder")]
    whole = view.mapFromScene(ends[0].united(ends[1])).boundingRect()
    corners = whole.topLeft() - QPoint(6, 6), whole.bottomRight() + QPoint(6, 6)
    assert view._item_at(corners[0]) is None
    QTest.mousePress(port, Qt.LeftButton, Qt.ShiftModifier, corners[0])
    move(view, whole.center())
    move(view, corners[1])
    QTest.mouseRelease(port, Qt.LeftButton, Qt.ShiftModifier, corners[1])
    keys = [item.vertex.key for item in scene.selectedItems()]
    assert {MOVED, "n_/nao1/recorder", "t_/nao1/preview"} <= set(keys) != set(scene.vertices)
    assert set(window.selection.keys) == set(keys) and not view.is_chosen
    before = [place_of(window, key) for key in keys]
    start = centre_of(view, MOVED)
    drag(view, start, start + QPoint(0, 40))
    ways = {place_of(window, key).minus(place) for key, place in zip(keys, before)}
    assert len({(round(x), round(y)) for x, y in ways}) == 1 and ways != {Point(0, 0)}
    assert set(window.graph.edits.places.present) == set(keys)


def test_places_belong_to_a_wiring_and_are_taken_over_by_the_next():
    places = Places()
    places.follow(["/a", "/b"])
    places.put({"n_/a": Point(1, 2)})
    places.follow(["/a", "/b", "/c"])
    assert places.present == {"n_/a": Point(1, 2)}
    places.put({"n_/a": Point(3, 4)})
    places.follow(["/b", "/a"])
    assert places.present == {"n_/a": Point(1, 2)}
    read = Places()
    read.follow(["/c", "/b", "/a"])
    read.read(places.to_text())
    assert read.present == {"n_/a": Point(3, 4)}
    places.follow(["/a", "/d"])
    read.follow(["/a", "/d"])
    read.read(places.to_text())
    assert read.present == {"n_/a": Point(1, 2)}
    for text in ("", "no", "[1]", '{"x": {"n_/a": [1]}}'):
        read.read(text)
    read.forget()
    for number in range(50):
        read.follow([f"/{number}"])
        read.put({"n_/a": Point(number, 0)})
    assert len(read._kept) == 20 and read.present == {"n_/a": Point(49, 0)}


def test_a_tidied_wiring_takes_over_no_places_when_it_comes_back():
    places = Places()
    places.follow(["/a"])
    places.put({"n_/a": Point(1, 2)})
    places.follow(["/a", "/b"])
    places.forget()
    places.follow(["/a"])
    assert places.present == {"n_/a": Point(1, 2)}
    places.follow(["/a", "/b"])
    assert places.present == {}
    assert len(json.loads(places.to_text())) == 1


# Wires


def test_a_wire_dropped_on_the_ground_makes_a_sink_or_a_source_there(qtbot, window, remote, view):
    ground = QPoint(300, view.viewport().height() - 60)
    place = view.mapToScene(ground)
    drag(view, view.place_of(CEILING), ground)
    press_menu(window, "tracker: position")
    until(qtbot, lambda: remote.graph().nodelet("/field/tracker_2") is not None)
    made = PortRef("/field/tracker_2", "position")
    assert topic(remote, made) == topic(remote, CEILING) == "/field/ceiling_camera/field_position"
    until(qtbot, lambda: "n_/field/tracker_2" in view.scene().vertices)
    assert (view.scene().vertices["n_/field/tracker_2"].pos() - place).manhattanLength() < 1
    undo(qtbot, window)
    until(qtbot, lambda: remote.graph().nodelet("/field/tracker_2") is None)
    until(qtbot, lambda: topic(remote, CEILING) == "")
    remote.client.set_config("/field/tracker", {"position": ""})
    until(qtbot, lambda: window.monitor.snapshot.port(TRACKER).topic == "")
    wait_for_drawing(qtbot, window)
    drag(view, view.place_of(TRACKER), QPoint(300, view.viewport().height() - 60))
    press_menu(window, "ceiling_camera: field_position")
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ceiling_camera_2/field_position")


def spare(qtbot, window, remote):
    """A nodelet that scales images, connected with nothing."""
    remote.client.spawn("resize", "/nao1/half", {})
    until(qtbot, lambda: "n_/nao1/half" in window.graph.view.scene().vertices)
    wait_for_drawing(qtbot, window)
    window.graph.view.fit()
    return PortRef("/nao1/half", "image"), PortRef("/nao1/half", "resized")


def middle_of(view, head, tail):
    edge = next(e for e in view.scene().edges if (e.head, e.tail) == (head, tail))
    path = view.scene().edges[edge].path
    return view.mapFromScene(path.pointAtPercent(0.5))


@pytest.mark.parametrize("ends", [("b_/nao1", f"t_{YUV}"), (f"t_{YUV}", "x_/viewer")])
def test_an_arrow_that_ends_at_no_port_is_connected_with_one(remote, ends):
    remote.client.spawn("resize", "/half", {})
    snapshot, edge = Snapshot(remote.graph().nodelets), Edge(ends[0], "", ends[1], "", YUV)
    for port in ("image", "resized"):
        change = splice(snapshot, PortRef("/half", port), edge)
        assert change.topics == ((PortRef("/half", port), YUV),)


def test_a_wire_ends_with_the_nodelet_that_it_begins_at(qtbot, window, remote):
    start, view = spare(qtbot, window, remote)[1], window.graph.view
    place = view.place_of(start)
    QTest.mousePress(view.viewport(), Qt.LeftButton, Qt.NoModifier, place)
    assert view.wire.start is view.scene().port_item(start)
    remote.client.destroy(start.nodelet)
    until(qtbot, lambda: view.scene().port_item(start) is None)
    view.scene().marks.clear()
    gc.collect()
    move(view, place + QPoint(60, 60))
    assert view.wire.start is None and window.line.text == ""
    QTest.mouseRelease(view.viewport(), Qt.LeftButton, Qt.NoModifier, place + QPoint(60, 60))
    assert window.line.text == ""


@pytest.mark.parametrize("side", [0, 1])
def test_a_wire_dropped_on_an_arrow_splices(qtbot, window, remote, side):
    ends, view = spare(qtbot, window, remote), window.graph.view
    start, on = view.place_of(ends[side]), middle_of(view, MOVED, f"t_{YUV}")
    QTest.mousePress(view.viewport(), Qt.LeftButton, Qt.NoModifier, start)
    move(view, on)
    lines = view.wire.text().split("\n")
    assert f"splice /nao1/half into {YUV}" in lines
    assert f"replaces {YUV} at /nao1/resize:image" in lines
    QTest.mouseRelease(view.viewport(), Qt.LeftButton, Qt.NoModifier, on)
    until(qtbot, lambda: topic(remote, RESIZE) == "/nao1/half/resized")
    assert (topic(remote, ends[0]), topic(remote, ends[1])) == (YUV, "/nao1/half/resized")
    undo(qtbot, window)
    until(qtbot, lambda: topic(remote, RESIZE) == YUV)
    assert topic(remote, ends[0]) == topic(remote, ends[1]) == ""


def test_spliced_before_a_topic_all_its_receivers_follow(qtbot, window, remote):
    ends, view = spare(qtbot, window, remote), window.graph.view
    drag(view, view.place_of(ends[0]), middle_of(view, f"t_{YUV}", "n_/nao1/top_camera"))
    until(qtbot, lambda: topic(remote, ends[1]) == YUV)
    source = topic(remote, PortRef("/nao1/top_camera", "yuv"))
    assert source == topic(remote, ends[0]) != YUV and topic(remote, RESIZE) == YUV


def test_a_wire_that_does_not_fit_an_arrow_says_why(qtbot, window, remote, view):
    drag(view, view.place_of(CEILING), middle_of(view, MOVED, f"t_{YUV}"))
    assert f"but {YUV} carries sensor_msgs/Image" in window.line.text
    drag(view, view.place_of(TRACKER), middle_of(view, "n_/field/tracker", "t_/field/ball"))
    assert "is at an end of this arrow already" in window.line.text
    drag(view, view.place_of(CEILING), middle_of(view, "n_/field/tracker", "t_/field/ball"))
    until(qtbot, lambda: topic(remote, TRACKER) == "/field/ceiling_camera/field_position")


# Menus


def test_a_nodelet_is_isolated_and_shares_a_process_again(qtbot, window, remote):
    def process():
        nodelet = window.monitor.snapshot.nodelet("/nao1/subsampler")
        return "none" if nodelet is None else "own" if nodelet.isolated else "shared"

    items = window.graph.view.scene().vertices
    entries = context_menu(qtbot, window, items["n_/nao1/subsampler"])
    entries["&Isolate in its own process"].trigger()
    until(qtbot, lambda: process() == "own")
    assert topic(remote, PortRef("/nao1/subsampler", "hsv")) == "/nao1/subsampler/hsv"
    until(qtbot, lambda: not window.monitor.is_changing)
    until(qtbot, lambda: "n_/nao1/subsampler" in vertex_keys(window))
    items = window.graph.view.scene().vertices
    context_menu(qtbot, window, items["n_/nao1/subsampler"])["Share a process"].trigger()
    until(qtbot, lambda: process() == "shared")


def test_nodelets_are_restarted_and_that_cannot_be_undone(qtbot, window, remote):
    items, done = window.graph.view.scene().vertices, []
    window.monitor.done.connect(done.append)
    context_menu(qtbot, window, items["n_/nao1/subsampler"])["Re&start"].trigger()
    until(qtbot, lambda: done == ["done: restart /nao1/subsampler"])
    undo(qtbot, window)
    until(qtbot, lambda: "was restarted" in window.line.text)


def test_parameters_are_shown_and_set(qtbot, window, remote):
    item = window.graph.view.scene().vertices["n_/nao1/ball_detector"]
    context_menu(qtbot, window, item)["Para&meters …"].trigger()
    (dialog,) = window.findChildren(ParametersDialog)
    assert dialog.fields["?robot"].isReadOnly() and dialog.fields["colour"].text() == "orange"
    assert dialog.fields["mount"].text() == "nao1_bottom_camera"
    dialog.fields["colour"].setText("yellow")
    dialog.more.setText("rate")
    dialog.buttons.accepted.emit()
    assert dialog.isVisible() and "expected NAME=VALUE" in window.line.text
    dialog.more.setText("rate = 5")
    dialog.buttons.accepted.emit()

    def given():
        nodelet = remote.graph().nodelet("/nao1/ball_detector")
        return {each.name: each.text for each in nodelet.parameters}

    until(qtbot, lambda: given().get("colour") == "yellow")
    assert given()["rate"] == "5" and given()["?robot"] == "nao1"
    until(qtbot, lambda: "colour is read at the next restart" in window.line.text)


def test_the_menu_of_a_topic_shows_its_last_message(qtbot, window):
    item = window.graph.view.scene().vertices[f"t_{YUV}"]
    entries = context_menu(qtbot, window, item)
    viewers = [each.text() for each in entries["&Open in"].menu().actions()]
    assert viewers == ["rqt_image_view", "rostopic echo"]
    entries["Show last &message"].trigger()
    assert window.graph.card.topic == YUV
    entries = context_menu(qtbot, window, window.graph.view.scene().vertices[MOVED])
    assert entries["&Log in"].menu().actions()[0].text() == "rqt_console"
