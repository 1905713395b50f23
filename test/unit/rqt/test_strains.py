# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Strains stand out in the drawing: much data, old messages, drops, load and errors."""

from __future__ import annotations

import pytest
from python_qt_binding.QtCore import QPointF, QRectF, Qt
from python_qt_binding.QtGui import QPainterPath, QTransform
from unit.rqt.hands import context_menu, until, vertex_keys, window_of

from dyknow.model.graph import PortRef
from dyknow_rqt.canvas.overview import _shapes
from dyknow_rqt.graph.rates import PortRate, Strain

CAMERA, TRACKER = "/nao1/bottom_camera", "/field/tracker"
#: Bytes a second, and pixels.
WIDTHS = ((None, 1.1), (0.0, 1.1), (1e6, 1.1), (5e6, 2.1), (20e6, 3.1), (100e6, 4.1), (1e12, 5.0))


@pytest.fixture
def scene(window):
    return window.graph.view.scene()


@pytest.fixture
def arrow(scene):
    return next(item for edge, item in scene.edges.items() if edge.tail == f"n_{CAMERA}")


def pixels(window, scene, area):
    """Colours of the picture in an area of the drawing."""
    view = window.graph.view
    image = view.viewport().grab().toImage()
    found = view.mapFromScene(area).boundingRect() & view.viewport().rect()
    return [
        image.pixelColor(x, y)
        for x in range(found.left(), found.right() + 1)
        for y in range(found.top(), found.bottom() + 1)
    ]


def share(colours, colour):
    """How many of them are nearly of a colour."""
    near = (
        sum(abs(a - b) for a, b in zip(each.getRgb()[:3], colour.getRgb()[:3])) < 60
        for each in colours
    )
    return sum(near) / len(colours)


@pytest.mark.parametrize(("bandwidth", "width"), WIDTHS)
def test_the_width_of_an_arrow_is_that_of_its_bandwidth(arrow, bandwidth, width):
    arrow.show(PortRate(30.0, 0.0, 300, 0, bandwidth), None, False)
    assert arrow.plain_stroke().widthF() == pytest.approx(width)
    assert arrow.plain_stroke().color() == arrow.colours.line
    arrow.show(PortRate(30.0, 0.0, 300, 0, bandwidth), None, True)
    assert arrow.plain_stroke().widthF() == 1.1, "nothing comes along one that is dead"


def test_a_wide_arrow_is_painted_wide(window, scene, arrow):
    def inked():
        ground = scene.colours.paper
        place = arrow.path.pointAtPercent(0.5)
        across = pixels(window, scene, QRectF(place, place).adjusted(-1, -9, 1, 9))
        return sum(each.lightness() < ground.lightness() - 60 for each in across)

    arrow.show(PortRate(30.0, 0.0, 300, 0, 0.0), None, False)
    arrow.place_label(None)
    window.graph.view.setTransform(QTransform())
    window.graph.view.centerOn(arrow.path.pointAtPercent(0.5))
    before = inked()
    arrow.show(PortRate(30.0, 0.0, 300, 0, 1e9), None, False)
    arrow.place_label(None)
    assert inked() > 1.8 * before > 0


@pytest.mark.parametrize(
    ("drop_rate", "age", "colour", "words"),
    [
        (0.0, None, "line", "30 Hz"),
        (0.0, 0.5, "line", "30 Hz"),
        (0.0, 2.0, "warning", "30 Hz\n2.0 s old"),
        (5.0, None, "alarm", "30 Hz\n−5.0/s"),
        (5.0, 2.0, "alarm", "30 Hz\n−5.0/s\n2.0 s old"),
        (0.0, 1e9, "line", "30 Hz"),
    ],
)
def test_old_and_dropped_messages_have_a_colour_and_words(arrow, drop_rate, age, colour, words):
    arrow.show(PortRate(30.0, drop_rate, 300, 0, None, age), None, False)
    assert arrow.plain_stroke().color() == getattr(arrow.colours, colour)
    assert arrow.label == words


def test_the_counts_of_the_manager_reach_the_drawing(window, scene, remote, qtbot, arrow):
    remote.client.samples[CAMERA, "yuv"] = (3.0, 2_000_000)
    until(qtbot, lambda: arrow.traffic is not None and arrow.traffic.is_old)
    assert arrow.plain_stroke().color() == scene.colours.warning
    traffic = window.monitor.traffic[PortRef(CAMERA, "yuv")]
    assert traffic.bandwidth == pytest.approx(traffic.rate * 2e6)
    assert arrow.plain_stroke().widthF() > 2.0
    assert "MB/s" in scene.facts.tip_of(arrow)
    assert "s old" in arrow.label


def test_rings_are_painted_around_what_is_busy_or_fails(qtbot, window, scene, remote):
    item = scene.vertices[f"n_{CAMERA}"]
    view = window.graph.view
    view.select(item)
    scene.clearSelection()

    def ring(part):
        """Colours along a part of the ring: shares of the circle from the top on."""
        view.setTransform(QTransform.fromScale(1.5, 1.5))
        view.centerOn(item)  # a layout that came late has moved it
        area = item.area.adjusted(-3, -3, 3, 3)
        path = QPainterPath()
        path.arcMoveTo(area, 90)
        path.arcTo(area, 90, -360)
        places = [path.pointAtPercent(part[0] + (part[1] - part[0]) * n / 40) for n in range(41)]
        image = view.viewport().grab().toImage()
        spots = [view.mapFromScene(QPointF(item.pos() + place)) for place in places]
        return [image.pixelColor(spot) for spot in spots]

    colours = scene.colours
    assert share(ring((0, 1)), colours.warning) == share(ring((0, 1)), colours.alarm) == 0
    remote.client.strains[CAMERA] = (0.75, "")
    until(qtbot, lambda: item.strain.busy == 0.75)
    assert share(ring((0.02, 0.70)), colours.warning) > 0.8  # the port hides a part
    assert share(ring((0.80, 0.98)), colours.warning) == 0
    remote.client.strains[CAMERA] = (0.75, "ZeroDivisionError")
    until(qtbot, lambda: item.strain.error)
    assert 0.2 < share(ring((0, 1)), colours.alarm) < 0.95, "dotted"
    assert "75 % of a core" in scene.facts.tip_of(
        item
    ) and "ZeroDivisionError" in scene.facts.tip_of(item)
    remote.client.strains[CAMERA] = (0.3, "")
    until(qtbot, lambda: item.strain.load == pytest.approx(0.3))
    assert share(ring((0, 1)), colours.warning) == share(ring((0, 1)), colours.alarm) == 0


def test_what_is_busy_or_fails_is_seen_from_far(qtbot, window, scene, remote):
    item = scene.vertices[f"n_{CAMERA}"]

    def look():
        ((width, colour, _, style), _), *_ = _shapes([item])
        return width, colour, style

    calm = look()
    remote.client.strains[CAMERA] = (0.9, "")
    until(qtbot, lambda: look() != calm)
    assert look() == (2.2, scene.colours.warning.rgba(), Qt.SolidLine)
    remote.client.strains[CAMERA] = (0.9, "late")
    until(qtbot, lambda: look() == (2.2, scene.colours.alarm.rgba(), Qt.DotLine))


def test_the_past_and_a_silent_manager_show_no_strain(qtbot, remote):
    remote.client.strains[CAMERA] = (0.9, "late")
    window = window_of(qtbot, remote)
    until(qtbot, lambda: f"n_{CAMERA}" in vertex_keys(window))
    item = window.graph.view.scene().vertices[f"n_{CAMERA}"]
    until(qtbot, lambda: item.strain.busy and item.strain.error)
    remote.client.is_up = False
    until(qtbot, lambda: item.strain == Strain())


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"owner": "/launch"}, f"{TRACKER} was loaded by /launch"),
        ({"is_protected": True}, "Release them from protection first"),
    ],
)
def test_what_cannot_be_destroyed_is_not_offered(qtbot, window, remote, fields, why):
    remote.client.alter(TRACKER, **fields)
    until(qtbot, lambda: window.monitor.snapshot.nodelet(TRACKER).owner == fields.get("owner", ""))
    until(
        qtbot,
        lambda: window.monitor.snapshot.nodelet(TRACKER).is_protected
        == ("is_protected" in fields),
    )
    item = window.graph.view.scene().vertices[f"n_{TRACKER}"]
    entries = context_menu(qtbot, window, item)
    barred = ["D&estroy …", "&Isolate in its own process"]
    if "owner" in fields:
        barred.append("Re&start")
    for text in barred:
        assert not entries[text].isEnabled() and why in entries[text].toolTip()
    assert not window.active.destroy.isEnabled() and why in window.active.destroy.toolTip()
    for place in (window.graph.view, window.active.table):
        window.line.clear()
        place.setFocus()
        qtbot.keyClick(place, Qt.Key_Delete)
        assert why in window.line.text and window.line.yes.isHidden()
