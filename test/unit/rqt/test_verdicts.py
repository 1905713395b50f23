# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Verdicts on the graph."""

from __future__ import annotations

from dataclasses import replace

import pytest
from python_qt_binding.QtCore import Qt
from unit.rqt.hands import FORMULAS, until

from dyknow.formulas import Truth, Verdict
from dyknow.model.graph import NodeletStatus, PortRef, PortState, State
from dyknow.model.streams import ClaimState, StreamRequest, StreamStatus
from dyknow.model.transformation import IN, OUT, VERDICT, Parameter
from dyknow_rqt.graph.verdicts import port_verdicts, verdict_sources

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
