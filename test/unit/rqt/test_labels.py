# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Labels of arrows and titles of boxes: legible, and over nothing else."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as some
from python_qt_binding.QtCore import QRectF
from python_qt_binding.QtGui import QColor, QFont, QFontMetricsF, QImage, QPainter, QPalette
from unit.rqt.hands import until

from dyknow_rqt.canvas.appearance import colours_of
from dyknow_rqt.canvas.overview import FAR, paint_titles
from dyknow_rqt.graph.figure import Edge
from dyknow_rqt.graph.geometry import Point, Rectangle, Size, boxes_around, place_labels

SIZE = Size(40.0, 12.0)


def edge(name):
    return Edge(f"n_/{name}", "out", "t_/topic", "", "/topic")


def straight(start, end):
    (a, b), (c, d) = start, end
    third, fourth = (c - a) / 3, (d - b) / 3
    return [Point(a + n * third, b + n * fourth) for n in range(4)]


def test_a_label_stands_above_the_middle_of_its_arrow():
    only = edge("a")
    places = place_labels({only: straight((0, 0), (200, 0))}, {only: SIZE}, [])
    assert places == {only: Rectangle(80.0, -14.0, 120.0, -2.0)}


def test_labels_of_neighbours_stand_side_by_side_or_not_at_all():
    edges = [edge(number) for number in range(8)]
    curves = {each: straight((0, 3.0 * n), (200, 3.0 * n)) for n, each in enumerate(edges)}
    places = place_labels(curves, {each: SIZE for each in edges}, [Rectangle(0, -20, 90, -1)])
    assert 1 < len(places) < len(edges)
    assert places[edges[0]].left >= 90


def test_a_steep_arrow_has_its_label_at_its_side():
    only = edge("a")
    area = place_labels({only: straight((0, 0), (0, 200))}, {only: SIZE}, [])[only]
    assert area.right <= -2.0 or area.left >= 2.0


PLACES = some.tuples(some.integers(-200, 200), some.integers(-200, 200))


@given(some.lists(some.tuples(PLACES, PLACES), max_size=20))
def test_labels_cover_nothing(ends):
    edges = [edge(number) for number in range(len(ends))]
    curves = {each: straight(*pair) for each, pair in zip(edges, ends)}
    wall = Rectangle(-50.0, -50.0, 50.0, 50.0)
    places = place_labels(curves, {each: SIZE for each in edges}, [wall])
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
    places = place_labels(curves, {each: SIZE for each in edges}, [])
    assert len(places) == 1000
    assert time.thread_time() - start < 20.0  # a quadratic search takes minutes


def test_in_the_drawing_no_label_covers_another_or_a_vertex(qtbot, window):
    scene = window.graph.view.scene()
    until(qtbot, lambda: any(item.is_dropping for item in scene.edges.values()))
    for mode, shown in ((1, False), (0, True)):
        window.graph.bar.choose("mode", mode)

        def is_drawn(shown=shown):
            return ("t_/field/ball" in scene.vertices) is shown and scene.is_labelled

        until(qtbot, is_drawn)
        labels = {e: item.label_area for e, item in scene.edges.items() if item.label}
        placed = [area for area in labels.values() if not area.isEmpty()]
        inked = [area for item in scene.vertices.values() for area in item.inked]
        for number, area in enumerate(placed):
            assert not any(area.intersects(other) for other in placed[number + 1 :] + inked)
    assert len(placed) == len(labels) > 10, "where topics are drawn, there is room for all"


_FONT = QFont("DejaVu Sans", 9)
_NODELET = Size(80.0, 30.0)


def painted_rows(zoom):
    """Rows of pixels that the title of a box takes, and how many are above its nodelet."""
    group = ("/nao1",)
    box = boxes_around({"a": group}, {"a": Point(0.0, 0.0)}, {"a": _NODELET})[group]
    image = QImage(400, 400, QImage.Format_RGB32)
    white = QColor("white")
    image.fill(white)
    painter = QPainter(image)
    painter.scale(zoom, zoom)
    painter.translate(-box.left, -box.top)
    owner = QRectF(box.left, box.top, box.right - box.left, box.bottom - box.top)
    paint_titles(painter, [(owner, "/nao1")], _FONT, colours_of(QPalette()), owner)
    painter.end()
    rows = [
        y for y in range(400) if any(image.pixelColor(x, y) != white for x in range(0, 400, 2))
    ]
    return rows, (-_NODELET.height / 2 - box.top) * zoom


@pytest.mark.parametrize("zoom", [0.55, 0.7, 0.85, 1.0, 2.0])
def test_titles_beside_legible_names_cover_no_nodelet(qapp, zoom):
    rows, room = painted_rows(zoom)
    assert rows and max(rows) < room


@pytest.mark.parametrize("zoom", [0.05, 0.1, 0.9 * FAR])
def test_titles_seen_from_far_are_as_large_as_texts_elsewhere(qapp, zoom):
    rows, _ = painted_rows(zoom)
    assert len(rows) >= QFontMetricsF(_FONT).height() - 1
