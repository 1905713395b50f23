# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Labels of arrows and titles of boxes: legible, and over nothing else."""

from __future__ import annotations

import time
from dataclasses import replace
from unittest.mock import Mock

import pytest
from hypothesis import given
from hypothesis import strategies as some
from python_qt_binding.QtCore import QPointF, QRectF
from python_qt_binding.QtGui import QColor, QFont, QFontMetricsF, QImage, QPainter, QPalette
from unit.rqt.hands import is_settled, until

from dyknow_rqt.canvas.appearance import LEAST_TEXT, ROOM, colours_of
from dyknow_rqt.canvas.arrows import EdgeItem
from dyknow_rqt.canvas.overview import FAR, paint_titles
from dyknow_rqt.canvas.vertices import VertexItem
from dyknow_rqt.graph.figure import Edge, Vertex, VertexKind
from dyknow_rqt.graph.geometry import Point, Rectangle, Size, boxes_around, place_labels
from dyknow_rqt.graph.measurements import PortRate

SIZE = Size(40.0, 12.0)
SIZES = (SIZE, Size(30.0, 12.0))


def edge(name):
    return Edge(f"n_/{name}", "out", "t_/topic", "", "/topic")


def straight(start, end):
    (a, b), (c, d) = start, end
    third, fourth = (c - a) / 3, (d - b) / 3
    return [Point(a + n * third, b + n * fourth) for n in range(4)]


def test_a_label_stands_above_the_middle_of_its_arrow_or_beside_a_steep_one():
    only = edge("a")
    places = place_labels({only: straight((0, 0), (200, 0))}, {only: SIZES}, [])
    assert places == {only: Rectangle(80.0, -14.0, 120.0, -2.0)}
    area = place_labels({only: straight((0, 0), (0, 200))}, {only: SIZES}, [])[only]
    assert area.right <= -2.0 or area.left >= 2.0


def test_labels_of_neighbours_stand_side_by_side_or_not_at_all():
    edges = [edge(number) for number in range(8)]
    curves = {each: straight((0, 3.0 * n), (200, 3.0 * n)) for n, each in enumerate(edges)}
    places = place_labels(curves, {each: SIZES for each in edges}, [Rectangle(0, -20, 90, -1)])
    assert 1 < len(places) < len(edges)
    assert places[edges[0]].left >= 90


def test_a_label_without_room_is_written_in_a_smaller_size():
    only = edge("a")
    posts = [Rectangle(-60, -20, 80, -1), Rectangle(115, -20, 260, -1)]
    posts.append(Rectangle(-60, 1, 260, 20))
    curve = straight((0, 0), (200, 0))
    area = place_labels({only: curve}, {only: SIZES}, posts)[only]
    assert area.right - area.left == SIZES[1].width


PLACES = some.tuples(some.integers(-200, 200), some.integers(-200, 200))


@given(some.lists(some.tuples(PLACES, PLACES), max_size=20))
def test_labels_cover_nothing(ends):
    edges = [edge(number) for number in range(len(ends))]
    curves = {each: straight(*pair) for each, pair in zip(edges, ends)}
    wall = Rectangle(-50.0, -50.0, 50.0, 50.0)
    places = place_labels(curves, {each: SIZES for each in edges}, [wall])
    areas = [*places.values(), wall]
    for number, area in enumerate(areas):
        assert not any(area.meets(other) for other in areas[number + 1 :])


def test_a_thousand_labels_are_placed_at_once():
    edges = [edge(number) for number in range(1000)]
    curves = {
        each: straight((n % 40 * 150, n // 40 * 60), (n % 40 * 150 + 100, n // 40 * 60 + 40))
        for n, each in enumerate(edges)
    }
    start = time.thread_time()
    places = place_labels(curves, {each: SIZES for each in edges}, [])
    assert len(places) == 1000
    assert time.thread_time() - start < 20.0  # a quadratic search takes minutes


#: Rates, drops and ages whose labels have one line to three.
TRAFFICS = (
    *((10.0, 0.0, None), (0.25, 0.0, None), (120.0, 0.0, None)),
    *((21.0, 8.5, None), (0.25, 0.0, 2.5)),
)


def test_where_topics_are_drawn_each_rate_is_written_and_no_label_covers_anything(qtbot, window):
    scene, monitor = window.graph.view.scene(), window.monitor
    until(qtbot, lambda: sum(bool(item.label) for item in scene.edges.values()) > 15)
    monitor._meter.take = lambda counts, moment: None
    measured = dict(monitor.traffic)
    least = LEAST_TEXT / QFontMetricsF(scene.typeface).ascent()
    for mode, shown in ((1, False), (0, True)):
        window.graph.bar.choose("mode", mode)
        until(qtbot, lambda shown=shown: ("t_/field/ball" in scene.vertices) is shown)
        for rate, drops, age in TRAFFICS:
            for ref, each in measured.items():
                now = replace(each, rate=rate, drop_rate=drops, age=age)
                monitor._meter.traffic[ref] = now
            monitor.measured.emit(monitor.traffic)
            until(qtbot, lambda: is_settled(window) and is_labelled(scene))
            items = [item for item in scene.edges.values() if item.label]
            assert {item.traffic.rate for item in items if item.traffic} == {rate}
            areas = [item.label_area for item in items if not item.label_area.isEmpty()]
            inked = [area for item in scene.vertices.values() for area in item.inked]
            for number, area in enumerate(areas):
                assert not any(area.intersects(other) for other in areas[number + 1 :] + inked)
            is_written = [item.label_scale >= least for item in items]
            assert sum(is_written) == 17 if shown else sum(is_written) > 5


@pytest.mark.parametrize("flow", [0, 2], ids=["to the right", "downwards"])
def test_the_name_of_a_port_covers_no_rate_of_its_arrows(qtbot, window, flow):
    scene, painter = window.graph.view.scene(), Mock()
    window.graph.bar.choose("direction", flow)
    until(qtbot, lambda: window.graph.drawn.is_downwards is bool(flow))
    until(qtbot, lambda: sum(bool(item.label) for item in scene.edges.values()) > 15)
    until(qtbot, lambda: is_settled(window) and is_labelled(scene))
    checked = 0
    for zoom in (0.6, 1.0):
        painter.worldTransform.return_value.m11.return_value = zoom
        for edge_, item in scene.edges.items():
            ends = ((edge_.tail, edge_.tail_port), (edge_.head, edge_.head_port))
            for port in [scene.vertices[key].ports[name] for key, name in ends if name]:
                port.set_offered(True)
                port.paint(painter, None)
                (area, _) = painter.fillRect.call_args.args
                assert port.rect().contains(area)
                assert not port.mapRectToScene(area).intersects(item.label_area), port.ref
                checked += item.label_area.isValid()
    assert checked > 30


def is_labelled(scene):
    jobs = (scene._draw, scene._show_all_traffic)
    return scene.labels.are_placed and not any(map(scene.slices.is_wanted, jobs))


def test_where_a_rate_stands_does_not_depend_on_its_value(qapp):
    item = EdgeItem(edge("a"), colours_of(QPalette()), _FONT)
    item.show(PortRate(9.96, 0.0, 1, 0), None, False)
    sizes = item.label_sizes
    for rate in (9.93, 10.0, 120.0, 0.99, 1.0, 0.0, 35.0):
        assert not item.show(PortRate(rate, 0.0, 1, 0), None, False)
        assert item.label_sizes == sizes
    assert item.show(PortRate(35.0, 0.25, 1, 0), None, False), "a line more"
    assert not item.show(PortRate(35.0, 9.96, 1, 0), None, False)


_FONT = QFont("DejaVu Sans", 9)
_NODELET = Size(80.0, 30.0)


def painted_rows(zoom, font):
    """Rows of pixels that the title of a box takes, and how many are above its nodelet."""
    group = ("/nao1",)
    box = boxes_around({"a": group}, {"a": Point(0.0, 0.0)}, {"a": _NODELET})[group]
    image = QImage(400, 400, QImage.Format_RGB32)
    image.fill(QColor("white"))
    painter = QPainter(image)
    painter.scale(zoom, zoom)
    painter.translate(-box.left, -box.top)
    owner = QRectF(box.left, box.top, box.right - box.left, box.bottom - box.top)
    paint_titles(painter, [(owner, "/nao1")], font, colours_of(QPalette()), owner)
    painter.end()
    return rows_of(image), (-_NODELET.height / 2 - box.top) * zoom


def rows_of(image, background="white"):
    """Rows of pixels that are painted."""
    across = range(0, image.width(), 2)
    plain = QColor(background)
    return [
        y for y in range(image.height()) if any(image.pixelColor(x, y) != plain for x in across)
    ]


@pytest.mark.parametrize("points", [9, 14])
@pytest.mark.parametrize("zoom", [1.1 * FAR, 0.45, 0.55, 0.7, 0.85, 1.0, 2.0])
def test_titles_beside_legible_names_cover_no_nodelet(qapp, zoom, points):
    rows, room = painted_rows(zoom, QFont("DejaVu Sans", points))
    assert rows and max(rows) < room


@pytest.mark.parametrize("zoom", [0.05, 0.1, 0.9 * FAR])
def test_titles_seen_from_far_are_as_large_as_texts_elsewhere(qapp, zoom):
    rows, _ = painted_rows(zoom, _FONT)
    assert len(rows) >= QFontMetricsF(_FONT).height() - 1


@pytest.mark.parametrize("zoom", [0.5, 0.6, 0.65, 0.7, 0.8, 0.9, 1.0, 2.0])
def test_a_rate_is_written_so_that_it_can_be_read_or_not_at_all(qapp, zoom):
    item = EdgeItem(edge("a"), colours_of(QPalette()), _FONT)
    end = QPointF(600.0, 0.0)
    item.set_curve(straight((0.0, 0.0), (600.0, 0.0)), QPointF(0.0, 0.0), end)
    item.show(PortRate(30.0, 0.0, 1, 0), None, False)
    item.place_label(Rectangle(100.0, -60.0, 100.0 + item.label_sizes[0].width, -40.0))
    image = QImage(400, 200, QImage.Format_RGB32)
    image.fill(QColor("white"))
    painter = QPainter(image)
    painter.translate(0.0, 150.0)
    painter.scale(zoom, zoom)
    item.paint(painter, None)
    painter.end()
    digits = [y for y in rows_of(image) if y < 150 - 20 * zoom]
    is_small = QFontMetricsF(_FONT).ascent() * zoom * ROOM < LEAST_TEXT
    assert len(digits) >= 0.7 * LEAST_TEXT if not is_small else not digits


@pytest.mark.parametrize("kind", [VertexKind.TOPIC, VertexKind.NODELET])
@pytest.mark.parametrize("is_downwards", [True, False])
@pytest.mark.parametrize("zoom", [0.5, 0.7, 1.0])
def test_a_vertex_is_drawn_around_its_name_where_no_port_is(qapp, kind, is_downwards, zoom):
    name, metrics = "stream0", QFontMetricsF(_FONT)
    item = VertexItem(Vertex("v", kind, name), colours_of(QPalette()), _FONT)
    size = Size(metrics.horizontalAdvance(name) + 4, metrics.height() + 4)
    item.set_vertex(replace(item.vertex, key="w"), size, is_downwards)
    painter = Mock()
    painter.worldTransform.return_value.m11.return_value = zoom
    item.paint(painter, None)
    draw = painter.drawRect if kind.is_square else painter.drawEllipse
    (area,) = draw.call_args.args
    written = metrics.horizontalAdvance(name) * max(1.0, LEAST_TEXT / metrics.ascent() / zoom)
    if is_downwards or kind.is_square or written < size.width:
        assert max(written, size.width) <= area.width() < written + 12
    else:
        assert area == item.area
    assert item.boundingRect().contains(area)


@pytest.mark.parametrize("zoom", [0.4, 0.6, 0.8])
@pytest.mark.parametrize("kind", [VertexKind.CLAIM, VertexKind.BOX, VertexKind.GHOST])
def test_a_note_is_written_below_its_name_or_not_at_all(qapp, kind, zoom):
    """The rest of a label that is cut is in the tool tip."""
    vertex = Vertex("v", kind, "/part3", note="10 nodelets\nhere")
    item = VertexItem(vertex, colours_of(QPalette()), _FONT)
    item.set_vertex(vertex, SIZE)
    larger = LEAST_TEXT / (QFontMetricsF(_FONT).ascent() * zoom)
    for lines in (1.0, 2.0, 3.0):
        written = item._cut(300.0, QFontMetricsF(_FONT).height() * lines / max(1.0, larger))
        assert written in ("/part3", "/part3\n10 nodelets\nhere")


def test_topics_side_by_side_do_not_meet_however_small_they_are(qapp):
    """They are as far apart as graphviz puts them in a downward flow."""
    item = VertexItem(Vertex("v", VertexKind.TOPIC, "x" * 40), colours_of(QPalette()), _FONT)
    size = Size(110.0, 30.0)
    item.set_vertex(replace(item.vertex, key="w"), size, True)
    painter = Mock()
    for zoom in (0.35, 0.5, 0.7):
        painter.worldTransform.return_value.m11.return_value = zoom
        item.paint(painter, None)
        (area,) = painter.drawRect.call_args.args
        assert zoom * (area.width() - size.width - 0.3 * 72) < 2.0  # or only with their margins
