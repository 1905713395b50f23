# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Re-wiring to watch: marks on parts that came, went, moved or were mended, and the time-line."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace

import pytest
from python_qt_binding.QtCore import QPoint, Qt
from unit.rqt.hands import (
    TRACKER,
    centre_of,
    click,
    context_menu,
    drag,
    is_settled,
    show,
    topic,
    until,
    vertex_keys,
)
from unit.rqt.test_graph import nodelet

from dyknow.formulas import Truth
from dyknow.model.graph import PortRef, State
from dyknow.model.streams import ClaimState, StreamRequest, StreamStatus
from dyknow.model.transformation import OUT, VERDICT, Port, Transformation, as_specification
from dyknow_rqt.canvas.appearance import Tone
from dyknow_rqt.canvas.items import Mark
from dyknow_rqt.graph.snapshot import Difference, GraphMoment, Moments, Snapshot, difference
from dyknow_rqt.screenshots import dark_palette

BALL = "/field/ball"


def moment(time, *nodelets, streams=()):
    return GraphMoment(time, Snapshot(tuple(nodelets)), tuple(streams))


def claim(*nodelets, state=ClaimState.ACTIVE):
    return StreamStatus("c1", "me", "Ball(?x)", "/t", "", state, "", nodelets, 0.0, ("?x=nao",))


def test_the_difference_of_two_moments_is_told():
    same, cut = nodelet("/same", ">in=/a"), nodelet("/cut", ">in=/a", "out>=/b")
    before = moment(1.0, same, cut, nodelet("/old", "out>=/a"), streams=[claim("/old", "/cut")])
    after = moment(
        2.0,
        same,
        replace(nodelet("/cut", ">in=/c", "out>=/b"), state=State.LOST),
        nodelet("/new", "out>=/c"),
        streams=[claim("/new", "/cut", state=ClaimState.DEGRADED)],
    )
    found = difference(before, after)
    assert (found.came, found.went) == ({"/new"}, {"/old"})
    assert found.moved == {PortRef("/cut", "in")} and found.mended == (("/old", "/new"),)
    assert found.lines == (
        "+ /new",
        "− /old",
        "/old → /new: mended",
        "/cut:in: /a → /c",
        "/cut: running → lost",
        "Ball(?x) ?x=nao: active → degraded",
    )
    assert difference(after, after) == Difference()


def test_of_several_parts_those_alike_are_paired():
    def part(name, label):
        return replace(nodelet(name, "out>"), transformation=label)

    before = moment(1.0, part("/a", "cam"), part("/b", "ball"), streams=[claim("/a", "/b")])
    after = moment(2.0, part("/c", "ball"), part("/d", "cam"), streams=[claim("/c", "/d")])
    assert difference(before, after).mended == (("/a", "/d"), ("/b", "/c"))


def test_moments_are_noted_when_something_differs_and_soon_together():
    moments, one, two = Moments(), nodelet("/one"), nodelet("/two")
    assert moments.note(moment(1.0, one)) and not moments.note(moment(2.0, nodelet("/one")))
    assert moments.note(moment(3.0, one, two)) and moments.note(moment(3.1, two))
    assert [len(each.snapshot.nodelets) for each in moments.all] == [1, 1]
    assert [each.time for each in moments.all] == [1.0, 3.0]
    talk = replace(claim("/two"), detail="no message yet")
    assert moments.note(moment(5.0, two, streams=[claim("/two")]))
    assert not moments.note(moment(6.0, two, streams=[talk]))
    for number in range(1000):
        moments.note(moment(10.0 + number, nodelet(f"/{number}")))
    assert len(moments.all) == 300 and moments.all[-1].snapshot.nodelet("/999")


# Marks


@pytest.fixture
def marks(window):
    return window.graph.view.scene().marks


def test_what_came_went_and_moved_is_marked_for_some_seconds(qtbot, window, remote, marks, scene):
    assert not any(item.mark for item in scene.vertices.values())
    remote.client.spawn("tracker", "/field/another", {"position": BALL})
    until(qtbot, lambda: "n_/field/another" in scene.vertices)
    until(qtbot, lambda: scene.vertices["n_/field/another"].mark is Mark.CAME)
    plain = window.graph.view.grab().toImage()
    remote.client.set_config("/nao1/resize", {"image": "/nao1/bottom_camera/yuv"})

    def arrow():
        return next((a for e, a in scene.edges.items() if e.head == "n_/nao1/resize"), None)

    until(qtbot, lambda: arrow() and arrow().mark is Mark.MOVED)
    remote.client.destroy("/nao1/recorder")
    until(qtbot, lambda: "n_/nao1/recorder" not in scene.vertices)
    until(qtbot, lambda: is_settled(window))
    ghost = marks.ghosts["/nao1/recorder"]
    assert scene.facts.tip_of(ghost) == "/nao1/recorder\nremoved"
    assert ghost.mark is Mark.WENT and ghost.scene() is scene and not ghost.isEnabled()
    assert window.graph.view._item_at(window.graph.view.mapFromScene(ghost.pos())) is None
    assert window.graph.view.grab().toImage() != plain
    place = ghost.pos()
    for where, is_seen in ((scene.vertices["n_/nao1/resize"].pos(), False), (place, True)):
        ghost.setPos(where)
        marks.apply()
        assert ghost.isVisible() is is_seen
    marks._noted = [(0.0, found) for _, found in marks._noted]
    marks._ending.start(0)
    until(qtbot, lambda: not marks.ghosts)
    assert ghost.scene() is None and not any(item.mark for item in scene.edges.values())
    assert not any(item.mark for item in scene.vertices.values())


def test_each_mark_ends_in_its_own_time(window, marks, monkeypatch):
    clock, vertices = SimpleNamespace(), window.graph.view.scene().vertices
    monkeypatch.setattr("dyknow_rqt.canvas.marks.time", clock, raising=False)
    for now, came in ((0.0, {"/nao1/resize"}), (7.0, {"/field/tracker"}), (8.0, set())):
        clock.monotonic = lambda now=now: now
        marks.show(Difference(frozenset(came)))
    assert vertices["n_/nao1/resize"].mark is None
    assert vertices["n_/field/tracker"].mark is Mark.CAME


def test_what_replaces_another_is_linked_with_it(qtbot, window, remote, marks):
    remote.client.destroy("/nao1/recorder")
    until(qtbot, lambda: marks.ghosts)
    marks.show(Difference(mended=(("/nao1/recorder", "/nao1/resize"), ("/gone", "/nao1/resize"))))
    line, text = marks.links
    ends = line.path().pointAtPercent(0.0), line.path().pointAtPercent(1.0)
    assert ends[0] == marks.ghosts["/nao1/recorder"].pos() and text.text() == "mended"
    assert ends[1] == window.graph.view.scene().vertices["n_/nao1/resize"].pos()
    heir = window.graph.view.scene().vertices["n_/nao1/resize"]
    marks.ghosts["/nao1/recorder"].setPos(heir.pos())
    marks.apply()
    line, text = marks.links
    assert not line.isVisible() and not text.sceneBoundingRect().intersects(heir.inked[0])
    remote.client.spawn("tracker", "/nao1/recorder", {})
    until(qtbot, lambda: not marks.ghosts and "n_/nao1/recorder" in vertex_keys(window))
    marks.clear()
    assert not marks.links


# The time-line


@pytest.fixture
def track(qtbot, window, remote, monkeypatch):
    """The time-line of four moments that are ten seconds apart, opened with its key."""
    clock, monitor = SimpleNamespace(**vars(time)), window.monitor
    monkeypatch.setattr("dyknow_rqt.graph_panel.timeline.time", clock)

    def is_read():
        names = [{each.name for each in of.nodelets} for of in (monitor.snapshot, remote.graph())]
        claims = [len(of) for of in (monitor.streams, remote.client.list_streams())]
        return names[0] == names[1] and claims[0] == claims[1]

    changes = (
        lambda: remote.client.spawn("tracker", "/field/another", {"position": BALL}),
        lambda: remote.client.acquire_stream(StreamRequest("Track(ball)")),
        lambda: remote.client.destroy("/nao1/recorder"),
    )
    for number, change in enumerate(changes, 1):
        moment = time.time() + 10 * number
        clock.time = lambda moment=moment: moment
        change()
        until(qtbot, is_read)
    assert len(window.graph.timeline.moments.all) == len(changes) + 1
    window.graph.view.setFocus()
    qtbot.keyClick(window.graph.view, Qt.Key_F7)
    assert window.graph.timeline.isVisible()
    return window.graph.timeline.track


def test_the_graph_is_seen_as_it_was_and_as_it_is_again(qtbot, window, remote, track):
    timeline, scene = window.graph.timeline, window.graph.view.scene()
    assert [tag for _, tag in track.lanes()] == ["Track(ball)"]
    picture = track.grab().toImage()
    lowest = {picture.pixelColor(x, track.height() - 4).name() for x in range(track.width())}
    assert track._colour(ClaimState.ACTIVE).name() in lowest
    paper = scene.backgroundBrush().color()
    assert "(now); last change: − /nao1/recorder" in timeline.words.text()
    for width, is_cut in ((200, True), (900, False)):
        timeline.resize(width, timeline.height())
        words = timeline.words.text()
        assert words.endswith("…") is is_cut
        assert timeline.words.fontMetrics().horizontalAdvance(words) <= width
    qtbot.mouseClick(track, Qt.LeftButton, pos=QPoint(0, 5))
    until(qtbot, lambda: "n_/nao1/recorder" in vertex_keys(window))
    until(qtbot, lambda: "n_/field/another" not in vertex_keys(window))
    assert "as it was; to now: + /field/another, − /nao1/recorder" in timeline.words.text()
    until(qtbot, lambda: scene.vertices["n_/nao1/recorder"].mark is Mark.WENT)
    assert scene.backgroundBrush().color() != paper
    until(qtbot, lambda: all(item.traffic is None for item in scene.edges.values()))
    qtbot.keyClick(track, Qt.Key_Right)
    until(qtbot, lambda: "n_/field/another" in vertex_keys(window))
    qtbot.keyClick(track, Qt.Key_Left)
    qtbot.keyClick(track, Qt.Key_End)
    until(qtbot, lambda: "n_/nao1/recorder" not in vertex_keys(window))
    assert timeline.moment is None and scene.backgroundBrush().color() == paper
    until(qtbot, lambda: any(item.traffic for item in scene.edges.values()))
    # Two moments of the past are compared.
    qtbot.keyClick(track, Qt.Key_Home)
    qtbot.keyClick(track, Qt.Key_Home, Qt.ShiftModifier)
    qtbot.keyClick(track, Qt.Key_Right, Qt.ShiftModifier)
    assert timeline.words.text().partition("to ")[2].partition(": ")[2] == "+ /field/another"
    qtbot.keyClick(track, Qt.Key_End, Qt.ShiftModifier)
    assert "to now: + /field/another" in timeline.words.text()


_CLOCK = "dyknow_rqt.graph_panel.timeline.time.time"


def test_a_clock_that_is_set_back_leaves_the_order_of_moments(
    qtbot, window, remote, track, monkeypatch
):
    monkeypatch.setattr(_CLOCK, lambda: 0.0)
    remote.client.spawn("tracker", "/field/later", {"position": BALL})
    until(qtbot, lambda: len(window.graph.timeline.moments.all) == 5)
    qtbot.keyClick(track, Qt.Key_Left)
    assert "to now: + /field/later" in window.graph.timeline.words.text()


def test_the_past_has_no_verdicts(qtbot, window, remote, track, monkeypatch):
    scene, port = window.graph.view.scene(), PortRef("/judge", "holds")
    judge = Transformation("judge", "a/Judge", ports=(Port("holds", OUT, VERDICT),))
    remote.client.add_transformation(as_specification([judge]))
    remote.client.spawn("judge", "/judge", {"holds": "/judge/holds"})
    until(qtbot, lambda: "n_/judge" in vertex_keys(window))
    later = time.time() + 60
    monkeypatch.setattr(_CLOCK, lambda: later)
    remote.client.destroy("/field/another")
    until(qtbot, lambda: "n_/field/another" not in vertex_keys(window))

    def shown():
        items = [item for edge, item in scene.edges.items() if edge.tail == "n_/judge"]
        return {item.verdict and item.verdict.truth for item in items}

    remote.decide("/judge/holds", Truth.TRUE)
    until(qtbot, lambda: shown() == {Truth.TRUE})
    qtbot.keyClick(track, Qt.Key_Left)
    until(qtbot, lambda: shown() == {None})
    remote.decide("/judge/holds", Truth.FALSE)
    until(qtbot, lambda: window.monitor.verdicts[port].truth is Truth.FALSE)
    assert not scene.facts.verdicts
    qtbot.keyClick(track, Qt.Key_End)
    until(qtbot, lambda: shown() == {Truth.FALSE})


def test_the_past_is_compared_with_each_new_present(
    qtbot, window, remote, track, scene, monkeypatch
):
    qtbot.keyClick(track, Qt.Key_Home)
    until(qtbot, lambda: "n_/nao1/recorder" in vertex_keys(window))
    assert scene.vertices["n_/nao1/resize"].mark is None
    later = time.time() + 60
    monkeypatch.setattr(_CLOCK, lambda: later)
    remote.client.destroy("/nao1/resize")
    until(qtbot, lambda: scene.vertices["n_/nao1/resize"].mark is Mark.WENT)


def test_the_past_has_no_plan(qtbot, window, track, scene):
    def is_kept():
        return any(item.tone is Tone.KEPT for item in scene.vertices.values())

    panel = show(window, window.streams)
    qtbot.keyClicks(panel.tag, "Track(ball)")
    click(qtbot, panel.preview)
    until(qtbot, is_kept)
    qtbot.keyClick(track, Qt.Key_Left)
    until(qtbot, lambda: not is_kept())
    window.tabs.setCurrentWidget(window.active)
    show(window, panel)
    until(qtbot, lambda: is_settled(window))
    assert not is_kept()
    qtbot.keyClick(track, Qt.Key_End)
    until(qtbot, is_kept)


def test_a_graph_of_the_past_is_not_said_to_be_empty(qtbot, window, remote, track):
    sign = window.graph.sign
    remote.client.set_protection("/nao1/bottom_camera", False)
    for each in remote.graph().nodelets:
        remote.client.destroy(each.name)
    until(qtbot, lambda: "No nodelets yet" in sign.text())
    qtbot.keyClick(track, Qt.Key_Home)
    until(qtbot, lambda: "n_/nao1/resize" in vertex_keys(window) and not sign.isVisible())
    qtbot.keyClick(track, Qt.Key_End)
    until(qtbot, lambda: "No nodelets yet" in sign.text() and sign.isVisible())


def test_the_past_is_not_changed_by_hands(qtbot, window, remote, track, view):
    qtbot.keyClick(track, Qt.Key_Home)
    until(qtbot, lambda: "n_/nao1/recorder" in vertex_keys(window))
    drag(view, view.place_of(TRACKER), QPoint(300, 300))
    before = view.scene().vertices["n_/nao1/resize"].pos()
    drag(view, centre_of(view, "n_/nao1/resize"), QPoint(300, 300))
    assert view.scene().vertices["n_/nao1/resize"].pos() == before
    past = view.scene().backgroundBrush().color()
    window.monitor.heart.linked.emit(True)
    assert view.scene().backgroundBrush().color() == past
    window.setPalette(dark_palette())
    until(qtbot, lambda: view.scene().backgroundBrush().color().lightness() < 100)
    colours = view.scene().colours
    assert view.scene().backgroundBrush().color() == colours.topic != colours.paper
    window.graph.view.menu_wanted.emit(None, QPoint(50, 50))
    assert "this is the past" in window.line.text and topic(remote, TRACKER) == BALL
    window.graph.bar.timeline.trigger()
    until(qtbot, lambda: "n_/nao1/recorder" not in vertex_keys(window))
    context_menu(qtbot, window, None)["Time"].trigger()
    assert window.graph.timeline.isVisible()
