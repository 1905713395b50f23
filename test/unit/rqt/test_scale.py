# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Many nodelets and little room: search hits are shown, and small parts are painted together."""

from __future__ import annotations

from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from python_qt_binding.QtCore import QObject, QPoint, Qt
from python_qt_binding.QtGui import QImage, QPalette
from python_qt_binding.QtWidgets import QToolButton
from unit.rqt.hands import button_of, centre_of, click, is_settled, until, vertex_keys, window_of

from dyknow.formulas import Truth
from dyknow_rqt.background_calls import Slices
from dyknow_rqt.canvas import arrows, vertices
from dyknow_rqt.canvas.overview import FAR
from dyknow_rqt.graph_panel.files import save_drawing
from dyknow_rqt.monitoring.simulated import tree
from dyknow_rqt.screenshots import dark_palette
from dyknow_rqt.window import DyKnowWidget

_COUNT = 200


@pytest.fixture(scope="module")
def crowd():
    return tree(_COUNT)


def is_drawn(window):
    return len(window.graph.drawn.vertices) == 2 * _COUNT and is_settled(window)


@pytest.fixture
def window(qtbot, crowd):
    """A window that is resized."""
    window = window_of(qtbot, crowd, (1366, 768))
    until(qtbot, lambda: is_drawn(window))
    return window


@pytest.fixture(scope="module")
def only(qapp, crowd):
    window = DyKnowWidget(crowd)
    window.resize(1366, 768)
    window.show()
    window.start()
    yield window
    window.shut_down()
    window.close()


@pytest.fixture
def shared(qtbot, only):
    """The one window of all tests that leave its size, with nothing found or selected."""
    only.graph.bar.search.clear()
    only.active.table.filter.clear()
    only.graph.view.scene().clearSelection()
    until(qtbot, lambda: is_drawn(only))
    only.graph.view.fit()
    return only


def is_seen(view, key):
    return view.seen.contains(view.scene().vertices[key].sceneBoundingRect())


def test_find_zooms_to_what_it_finds(qtbot, shared):
    view = shared.graph.view
    assert view.zoom < FAR
    qtbot.keyClicks(shared.graph.bar.search, "part7/n")
    for number in range(10):
        qtbot.keyClick(shared.graph.bar.search, Qt.Key_Return)
        assert shared.graph.bar.hits.text() == f"{number + 1} of 10"
        (item,) = view.scene().selectedItems()
        assert is_seen(view, item.vertex.key) and view.zoom > 2 * FAR


def test_a_row_shows_where_its_nodelet_is(qtbot, shared):
    table, view = shared.active.table, shared.graph.view
    qtbot.keyClicks(table.filter, "part13/nodelet4")
    assert table.names() == ["/part13/nodelet4"]
    table.selectRow(0)
    assert is_seen(view, "n_/part13/nodelet4") and view.zoom > 2 * FAR
    table.filter.clear()
    assert table.chosen() == ["/part13/nodelet4"] and len(table.names()) == _COUNT
    view.select(view.scene().vertices["n_/part4/nodelet2"])
    assert table.chosen() == ["/part4/nodelet2"]
    assert table.visualRect(table.selectionModel().selectedRows()[0]).intersects(
        table.viewport().rect()
    )


def test_the_map_shows_what_is_seen_and_moves_there(qtbot, shared):
    view = shared.graph.view
    minimap = view._minimap
    assert not minimap.isVisible()
    view.reveal([view.scene().vertices["n_/part13/nodelet4"]])
    assert minimap.isVisible()
    before = view.seen.center()
    qtbot.mouseClick(minimap, Qt.LeftButton, pos=QPoint(3, minimap.height() // 2))
    assert view.seen.center().x() < before.x()
    view.fit()
    assert not minimap.isVisible()


def test_without_nodelets_there_is_no_map(qtbot):
    widget = window_of(qtbot, tree(0))
    scene, minimap = widget.graph.view.scene(), widget.graph.view._minimap
    scene.look_again()
    scene.slices.want(minimap._picture)
    until(qtbot, lambda: not scene.slices.is_wanted(minimap._picture))
    assert widget.line.text == "" and not minimap.isVisible()


def test_work_in_slices_is_done_once_more_if_it_was_wanted_meanwhile(qtbot):
    done, parent = [], QObject()
    slices = Slices(parent)

    def work():
        done.append("begun")
        yield
        if len(done) == 1:
            slices.want(work)
            slices.want(work)

    def fail():
        raise OSError("no room")
        yield

    slices.want(fail)
    slices.want(work)
    with qtbot.capture_exceptions() as said:
        until(qtbot, lambda: not (slices.is_wanted(work) or slices.is_wanted(fail)))
    assert done == ["begun", "begun"] and [str(error) for _, error, _ in said] == ["no room"]


def test_what_is_too_small_for_names_is_painted_together_and_hit_all_the_same(qtbot, shared):
    view, scene = shared.graph.view, shared.graph.view.scene()
    item = scene.vertices["n_/part0/nodelet0"]
    until(qtbot, lambda: item.is_far)
    assert item in view.items(centre_of(view, "n_/part0/nodelet0"))
    plain = shared.graph.view.grab().toImage()
    item.setSelected(True)
    assert shared.graph.view.grab().toImage() != plain
    view.reveal([item])
    assert not item.is_far


def test_a_title_stays_in_view_with_its_box(qtbot, shared):
    view, scene = shared.graph.view, shared.graph.view.scene()
    view.fit()
    assert not scene.has_sticky_titles(view.seen)
    box = scene.boxes["/part7",]
    view.zoom_by(3.0 / view.zoom)  # also a box of the first layout is larger than the view
    view.centerOn(box.area.center())
    assert not view.seen.contains(box.area.topLeft()) and scene.has_sticky_titles(view.seen)
    titled = view.grab().toImage()
    box.name = ""
    assert view.grab().toImage() != titled
    box.name = "/part7"
    assert view.grab().toImage() == titled


def test_names_and_rates_are_large_enough_to_be_read(qtbot, shared, monkeypatch):
    view, sizes = shared.graph.view, []

    def note(painter, area, text, larger):
        sizes.append(painter.fontMetrics().ascent() * larger * view.zoom)

    for module in (vertices, arrows):
        monkeypatch.setattr(module, "write", note)
    for zoom in (0.31, 0.5, 0.7, 1.0):
        sizes.clear()
        view.zoom_by(zoom / view.zoom)
        view.centerOn(view.scene().vertices["n_/part7/nodelet3"])
        view.grab()
        assert sizes and min(sizes) >= 8.9


def test_what_is_small_is_judged_by_the_pixels_of_the_screen(qtbot, shared, monkeypatch):
    view = shared.graph.view
    view.zoom_by(0.7 * FAR / view.zoom)
    assert view.scene().is_far
    monkeypatch.setattr(view, "devicePixelRatioF", lambda: 2.0)
    view._follow()
    assert not view.scene().is_far


@pytest.mark.parametrize("name", ["graph.png", "graph.svg"])
def test_the_view_is_as_before_when_a_picture_has_been_saved(qtbot, shared, tmp_path, name):
    view, scene = shared.graph.view, shared.graph.view.scene()
    jobs = (scene._tell_looks, scene._picture, scene._show_all_traffic)

    def is_still():
        return is_settled(shared) and not any(scene.slices.is_wanted(job) for job in jobs)

    view.zoom_by(0.7 * FAR / view.zoom)
    until(qtbot, lambda: is_still() and abs(scene.overview.scale - view.zoom) < 1e-6)
    before = view.viewport().grab().toImage()
    save_drawing(scene, str(tmp_path / name))
    if name.endswith("svg"):
        assert "nodelet7" in (tmp_path / name).read_text(), "names also of what is seen from far"
    else:
        assert not QImage(str(tmp_path / name)).isNull()
    scene.look_again()
    until(qtbot, is_still)
    assert scene.is_far and abs(scene.zoom - view.zoom) < 1e-6
    assert view.viewport().grab().toImage() == before


def test_a_double_click_collapses_a_box_and_opens_it(qtbot, shared):
    view = shared.graph.view
    box = view.scene().boxes[("/part7",)].area
    qtbot.mouseDClick(view.viewport(), Qt.LeftButton, pos=view.mapFromScene(box.center()))
    until(qtbot, lambda: "b_/part7" in vertex_keys(shared))
    assert "n_/part7/nodelet3" not in vertex_keys(shared)
    assert "n_/part8/nodelet3" in vertex_keys(shared)
    assert "10 nodelets" in view.scene().vertices["b_/part7"].vertex.label
    place = centre_of(view, "b_/part7")
    qtbot.mouseDClick(view.viewport(), Qt.LeftButton, pos=place)
    until(qtbot, lambda: "n_/part7/nodelet3" in vertex_keys(shared))


def test_boxes_can_be_nodelet_managers_and_collapsed_all_at_once(qtbot, shared):
    shared.graph.bar.choose("boxes", 1)
    until(qtbot, lambda: shared.graph.drawn.groups() == [("/dyknow_nodelet_manager",)])
    shared.graph.bar.collapse(shared.graph.drawn.groups())
    until(qtbot, lambda: vertex_keys(shared) == {"b_/dyknow_nodelet_manager"})
    shared.graph.bar.collapse(())
    until(qtbot, lambda: len(vertex_keys(shared)) == 2 * _COUNT)
    shared.graph.bar.choose("boxes", 0)


def test_in_a_narrow_window_streams_flow_downwards(qtbot, window):
    window.resize(500, 900)
    click(qtbot, window.graph.bar.panel)
    until(qtbot, lambda: window.graph.drawn.is_downwards)
    vertices = window.graph.view.scene().vertices
    chain = [vertices[f"n_/part0/nodelet{number}"] for number in (0, 1, 3)]
    # at once, or when Graphviz is done
    until(qtbot, lambda: chain[0].y() < chain[1].y() < chain[2].y())
    window.graph.bar.choose("direction", 1)
    until(qtbot, lambda: not window.graph.drawn.is_downwards)
    assert vertices["n_/part0/nodelet0"].x() < vertices["n_/part0/nodelet1"].x()


def test_a_view_of_another_shape_is_filled_anew(qtbot, window):
    view = window.graph.view

    def shape():
        area = view.scene().drawing_area()
        return area.width() / area.height()

    before = shape()
    window.resize(1366, 420)
    until(qtbot, lambda: shape() > 1.5 * before)
    view.zoom_by(2.0)
    asked = []
    window.graph.layouter.ready.connect(asked.append)
    window.resize(1366, 900)
    window.graph._turn()
    assert not asked and not window.graph._wants_tidy


def test_a_fresh_rqt_shows_the_graph_and_puts_all_else_away(qtbot, window):
    assert window.tabs.x() < window.graph.x(), "beside the graph in a wide window"
    window.resize(600, 450)
    view, bar = window.graph.view, window.graph.bar
    until(qtbot, lambda: view.width() * view.height() >= 0.6 * 600 * 450)
    assert not window.tabs.isVisible()
    window.monitor.heart.told.disconnect(window.line.show_status)
    window.line.contact.setText("/dyknow_manager has not answered for a long time " * 3)
    assert window.line.minimumSizeHint().width() < 400
    until(qtbot, lambda: window.minimumWidth() < 400)
    window.resize(320, 240)
    assert window.width() < 400 and view.isVisible()
    button = bar.findChild(QToolButton, "qt_toolbar_ext_button")
    until(qtbot, button.isVisible)
    assert not button_of(bar.load).isVisible() and bar.load in button.menu().actions()
    assert bar.view.menu().actions() and bar.view in button.menu().actions()
    button.menu().actions()[-1].trigger()
    window.resize(1366, 768)
    assert window.tabs.isVisible() and button_of(bar.load).isVisible()
    window.resize(600, 900)
    assert window.tabs.y() > window.graph.y(), "below it in a narrow one"


def test_icons_are_seen_on_any_ground(qtbot, shared):
    for palette in (QPalette(), dark_palette()):
        shared.setPalette(palette)
        icon = shared.graph.bar.fit.icon().pixmap(24, 24).toImage()
        strokes = [icon.pixelColor(x, y) for x in range(24) for y in range(24)]
        ground, words = (palette.color(role) for role in (QPalette.Button, QPalette.ButtonText))
        inks = {each.lightness() for each in strokes if each.alpha() > 240}
        assert inks and all(abs(ink - words.lightness()) < 40 for ink in inks), ground.name()
    shared.setPalette(QPalette())


@pytest.mark.parametrize(
    ("zoom", "truth", "is_seen"),
    [(1.0, Truth.UNKNOWN, True), (0.3, Truth.UNKNOWN, False), (0.3, Truth.FALSE, True)],
)
def test_ports_are_painted_where_they_tell_something(window, zoom, truth, is_seen):
    vertices = window.graph.view.scene().vertices.values()
    item, painter = next(port for each in vertices for port in each.ports.values()), Mock()
    painter.worldTransform.return_value.m11.return_value = zoom
    item.verdict = SimpleNamespace(truth=truth)
    item.paint(painter, None)
    assert (painter.drawEllipse.called or painter.drawRect.called) is is_seen
