# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What stands out in the drawing: much data, old messages, drops, load, errors, verdicts."""

from __future__ import annotations

from dataclasses import replace

import pytest
from python_qt_binding.QtCore import QPointF, QRectF, Qt
from python_qt_binding.QtGui import QPainterPath, QTransform
from unit.rqt.hands import FORMULAS, context_menu, until

from dyknow.formulas import Truth, Verdict
from dyknow.model.graph import NodeletStatus, PortRef, PortState, State
from dyknow.model.streams import ClaimState, StreamRequest, StreamStatus
from dyknow.model.transformation import IN, OUT, VERDICT, Parameter
from dyknow_rqt.canvas.overview import _shapes
from dyknow_rqt.graph.measurements import PortRate, port_verdicts, verdict_sources

CAMERA, TRACKER = "/nao1/bottom_camera", "/field/tracker"
#: Bytes a second, and pixels.
WIDTHS = ((None, 1.1), (0.0, 1.1), (1e6, 1.1), (5e6, 2.1), (20e6, 3.1), (100e6, 4.1), (1e12, 5.0))


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


def test_rings_are_painted_around_what_is_busy_or_fails(qtbot, scene, remote, view):
    item = scene.vertices[f"n_{CAMERA}"]
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


HOLDS = PortRef("/charged_1", "holds")
LOW = Verdict(12_300_000_000, Truth.FALSE, 12_300_000_000, "battery.percentage = 0.19 at 12.2")


def formula(name, tags=(), topic="/t", state=State.RUNNING, parameters=()):
    ports = (
        PortState("battery", IN, "sensor_msgs/BatteryState", "/battery"),
        PortState("verdicts", IN, VERDICT, "/read"),
        PortState("holds", OUT, VERDICT, topic, tags),
        PortState("image", OUT, "sensor_msgs/Image", "/image"),
    )
    return NodeletStatus(name, "", "/m", False, False, False, state, "", ports, parameters)


def claim(tag, topic, state=ClaimState.ACTIVE):
    return StreamStatus("1", "dyknow_manager", tag, topic, VERDICT, state, "", (), 0.0)


def test_verdicts_are_heard_from_the_nodes_of_formulas_that_run():
    nodelets = [formula("/a"), formula("/b", topic=""), formula("/c", state=State.LOST)]
    nodelets.append(replace(formula("/d", topic="/u"), manager=""))
    assert verdict_sources(nodelets) == {("/m", "/t"), ("/d", "/u")}


@pytest.mark.parametrize(
    ("nodelet", "streams", "name"),
    [
        (formula("/a", ("Holds(?r)",)), [claim("Holds(nao)", "/t")], "Holds(nao)"),
        (
            formula("/a", ("Holds(?r)",)),
            [claim("Holds(nao)", "/t", ClaimState.RELEASED), claim("Holds(it)", "/u")],
            "Holds(?r)",
        ),
        (formula("/a", parameters=(Parameter("formula", "string", "p < 1"),)), [], "p < 1"),
        (formula("/a"), [], "holds"),
    ],
    ids=["claim", "tag", "formula", "port"],
)
def test_a_verdict_names_its_formula_since_when_and_why(nodelet, streams, name):
    ref = PortRef("/a", "holds")
    found = port_verdicts([nodelet], {"/t": LOW}, streams)
    assert found.keys() == {ref} and found[ref].truth is Truth.FALSE
    because = "battery.percentage = 0.19 at 12.2"
    assert found[ref].text == f"{name}: FALSE since 12.300\n{because}"
    found = port_verdicts([nodelet], {"/t": LOW._replace(why="")}, streams)
    assert found[ref].text == f"{name}: FALSE since 12.300"
    found = port_verdicts([nodelet], {"/t": None}, streams)
    assert (found[ref].truth, found[ref].text) == (Truth.UNKNOWN, f"{name}: no verdict yet")


@pytest.fixture
def charged(qtbot, window, remote):
    """The window, once it shows a formula and follows its verdicts."""
    remote.client.add_transformation(FORMULAS.read_text())
    remote.client.acquire_stream(StreamRequest("Holds(charged, nao)", client_id="test"))
    until(qtbot, lambda: _arrow(window) is not None and _arrow(window).verdict is not None)
    until(qtbot, lambda: "Holds(charged, nao)" in _arrow(window).verdict.formula)
    return window


def _arrow(window):
    edges = window.graph.view.scene().edges
    return next((edges[each] for each in edges if each.tail == "n_/charged_1"), None)


def test_the_arrow_of_a_formula_has_the_colour_of_its_verdict(qtbot, charged, remote):
    scene = charged.graph.view.scene()
    until(qtbot, lambda: _arrow(charged).label == "0 Hz")
    looks = []
    for truth in (None, Truth.TRUE, Truth.FALSE, Truth.UNKNOWN):
        if truth is not None:
            remote.decide("/charged_1/holds", truth, 12_300_000_000, "p = 1 < 2")
            until(qtbot, lambda truth=truth: truth.name in _arrow(charged).verdict.text)
        arrow = _arrow(charged)
        pen, port = arrow.stroke(), scene.port_item(HOLDS)
        assert port.truth is arrow.verdict.truth
        said = f"{truth.name} since 12.300\np = 1 < 2" if truth is not None else "no verdict yet"
        for item in (arrow, port, scene.vertices["t_/charged_1/holds"]):
            assert f"Holds(charged, nao): {said}" in scene.facts.tip_of(item)
        looks.append((arrow.label.split("\n")[1:], pen.color().name(), pen.style()))
    colours = arrow.colours
    assert looks == [
        ([], colours.line.name(), Qt.DotLine),
        (["TRUE"], colours.true.name(), Qt.SolidLine),
        (["FALSE"], colours.false.name(), Qt.DashLine),
        ([], colours.line.name(), Qt.DotLine),
    ]
    others = [item for edge, item in scene.edges.items() if edge.tail != "n_/charged_1"]
    assert {item.verdict for item in others} == {None}
    remote.client.alter("/charged_1", state=State.LOST)
    until(qtbot, lambda: _arrow(charged).verdict.verdict is None)
    assert not remote.followed


def test_of_verdicts_that_come_together_the_last_one_is_shown(qtbot, charged, remote):
    monitor, told = charged.monitor, []
    remote.decide("/charged_1/holds", Truth.TRUE)
    until(qtbot, lambda: monitor.verdicts[HOLDS].truth is Truth.TRUE)
    monitor.decided.connect(told.append)
    for truth in (Truth.FALSE, Truth.TRUE):
        remote.decide("/charged_1/holds", truth)
    until(qtbot, lambda: told)
    assert told[0][HOLDS].truth is Truth.TRUE


def test_the_port_shows_the_verdict_where_nothing_listens(qtbot, charged, remote):
    charged.graph.bar.choose("mode", 1)
    until(qtbot, lambda: _arrow(charged) is None)
    scene = charged.graph.view.scene()

    def port_colours():
        port = scene.port_item(HOLDS)
        place = port.mapToScene(port.shape().boundingRect()).boundingRect()
        view = charged.graph.view
        view.centerOn(place.center())
        image = view.grab(view.mapFromScene(place).boundingRect()).toImage()
        pixels = ((x, y) for x in range(image.width()) for y in range(image.height()))
        return {image.pixelColor(*pixel).name() for pixel in pixels}

    colours = scene.port_item(HOLDS).colours
    for truth, colour in ((Truth.TRUE, colours.true), (Truth.FALSE, colours.false)):
        remote.decide("/charged_1/holds", truth)
        until(qtbot, lambda colour=colour: colour.name() in port_colours())
