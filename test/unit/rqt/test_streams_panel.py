# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tab Streams."""

from __future__ import annotations

from threading import Event
from types import SimpleNamespace

import pytest
from clocks import wait_for
from python_qt_binding.QtCore import Qt
from python_qt_binding.QtGui import QGuiApplication
from unit.rqt.hands import (
    FORMULAS,
    cells_of,
    click,
    is_settled,
    no_boxes,
    show,
    undo,
    until,
    vertex_keys,
)
from unit.rqt.test_health import slow_change

from dyknow.model.graph import State
from dyknow.model.streams import Replanned, StreamEvent, StreamRequest
from dyknow_rqt.canvas.appearance import Tone
from dyknow_rqt.graph.filters import tag_completions

_WEATHER = (
    "<transformation><label>weather</label><source>sky/Weather</source>"
    '<ports><port type="out">out</port></ports>'
    '<tags><tag port="out">Weather(today)</tag></tags></transformation>'
)


def _ask_for(qtbot, window, tag):
    panel = show(window, window.streams)
    panel.tag.clear()
    qtbot.keyClicks(panel.tag, tag)
    return panel


def test_a_stream_is_previewed_acquired_and_released(qtbot, window, remote):
    panel = _ask_for(qtbot, window, "Track(ball)")
    before = remote.graph().nodelets
    qtbot.keyClick(panel.tag, Qt.Key_Return)
    until(qtbot, lambda: "Track(ball)  0  proven least" in panel.plan.text)
    panel.exclude.setText("tracker ; localization")
    click(qtbot, panel.preview)
    until(qtbot, lambda: "excluded" in panel.plan.text)
    panel.exclude.clear()
    assert remote.graph().nodelets == before and not panel.table.names()

    click(qtbot, panel.acquire)
    active = ["Track(ball)", "active: no message yet", "/field/tracker/track"]
    until(qtbot, lambda: panel.table.names() and cells_of(panel.table, 0)[1:4] == active)
    until(qtbot, lambda: "Track(ball): active (requested" in panel.events.toPlainText())
    until(qtbot, lambda: "done: acquire Track(ball): on /field/tracker/track" in window.line.text)
    panel.table.choose(panel.table.names())
    chosen = {item.vertex.name for item in window.graph.view.scene().selectedItems()}
    assert {"/field/tracker", "/nao1/bottom_camera"} <= chosen
    click(qtbot, panel.release)
    until(qtbot, lambda: not panel.table.names())
    panel.ended.setChecked(True)
    assert cells_of(panel.table, 0)[2] == "released" and not panel.release.isEnabled()
    until(qtbot, lambda: "active → released" in panel.events.toPlainText())
    (stream,) = window.monitor.streams
    window.monitor.stream_event.emit(StreamEvent(0.0, stream, stream, "forgotten"))
    assert panel.events.toPlainText().endswith("Track(ball): released (forgotten)")


def test_two_quick_clicks_acquire_one_stream(qtbot, window, monkeypatch):
    panel, monitor, asked = _ask_for(qtbot, window, "Track(ball)"), window.monitor, []
    with monkeypatch.context() as patch:
        patch.setattr(monitor, "ask", lambda *question: asked.append(question))
        for _ in range(2):
            qtbot.mouseClick(panel.acquire, Qt.LeftButton)
    (question,) = asked
    monitor.ask(*question)
    until(qtbot, lambda: panel.acquire.isEnabled() and monitor.history.texts[0])


def test_a_stream_that_waits_for_another_change_is_acquired_once(
    qtbot, window, remote, monkeypatch
):
    panel, monitor, asked = _ask_for(qtbot, window, "Track(ball)"), window.monitor, []
    (slow, may), may_acquire, acquire = slow_change(), Event(), remote.client.acquire_stream

    def acquire_late(request, dry_run=False):
        assert dry_run or wait_for(may_acquire) is None
        return acquire(request, dry_run=dry_run)

    monkeypatch.setattr(remote.client, "acquire_stream", acquire_late)
    with monkeypatch.context() as patch:
        patch.setattr(monitor, "ask", lambda *question: asked.append(question))
        qtbot.mouseClick(panel.acquire, Qt.LeftButton)
    monitor.settled.emit()  # another change, while the plan is being made
    assert not panel.acquire.isEnabled()
    monitor.do(slow)
    monitor.ask(*asked[0])
    until(qtbot, lambda: window.line.text.startswith("acquire Track(ball): waiting"))
    monitor.redo()  # there is nothing: it is refused after all
    may.set()
    until(qtbot, lambda: window.line.text == "acquire Track(ball) …")
    assert not panel.acquire.isEnabled()
    may_acquire.set()
    until(qtbot, panel.acquire.isEnabled)
    assert not monitor.is_changing and len(remote.client.list_streams()) == 1


def test_the_stream_of_another_client_does_not_take_the_place_of_a_refused_one(
    qtbot, window, remote
):
    panel = _ask_for(qtbot, window, "Track(ball)")
    panel.require.setText("it.pose.x <")
    click(qtbot, panel.acquire)
    until(qtbot, lambda: panel.acquire.isEnabled() and "expected a formula" in window.line.text)
    shown = panel.plan.text
    other = remote.client.acquire_stream(StreamRequest("Track(ball)", client_id="other"))
    until(qtbot, lambda: other.claim_id in panel.table.names())
    assert panel.plan.text == shown


def test_a_user_without_a_name_asks_for_streams(qtbot, window, monkeypatch):
    """As in a container."""
    for name in ("LOGNAME", "USER", "LNAME", "USERNAME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", {}.__getitem__)
    panel = _ask_for(qtbot, window, "Track(ball)")
    assert panel.request().client_id.startswith("window on ")


def test_what_matters_is_asked_for(qtbot, window, remote):
    panel = _ask_for(qtbot, window, "Track(ball)")
    assert (panel.request().min_rate, panel.request().max_age, panel.request().avoid) == (0, 0, ())
    panel.rate.setValue(10.0)
    panel.age.stepUp()
    assert panel.age.value() == 0.1
    panel.age.setValue(0.25)
    panel.prefer.setText("tracker")
    panel.avoid.setText(" bottom camera;; BallObject ")
    asked = panel.request()
    assert (asked.min_rate, asked.max_age) == (10.0, 0.25)
    assert (asked.prefer, asked.avoid) == (("tracker",), ("bottom camera", "BallObject"))
    panel.age.setValue(0.0)
    click(qtbot, panel.preview)
    until(qtbot, lambda: "Track(ball) [at least 10 Hz]" in panel.plan.text)
    assert "runs as /field/ceiling_camera" in panel.plan.text  # instead of a detector


def test_an_excluded_label_that_belongs_to_nothing_is_reported(qtbot, window, remote):
    panel = _ask_for(qtbot, window, "Track(ball)")
    panel.exclude.setText("bottom camra")
    click(qtbot, panel.preview)
    until(qtbot, lambda: "labelled 'bottom camra'" in window.line.text)
    click(qtbot, panel.acquire)
    until(qtbot, lambda: window.line.text.startswith("done: acquire Track(ball): on /"))
    assert "labelled 'bottom camra'" in window.line.text


def test_what_variables_stand_for_is_shown(qtbot, window, remote):
    panel = _ask_for(qtbot, window, "FieldPosition(?what)")
    click(qtbot, panel.acquire)
    until(qtbot, lambda: len(panel.table.names()) == 1)
    assert cells_of(panel.table, 0)[1] == "FieldPosition(?what) ?what=ball"
    until(qtbot, lambda: "FieldPosition(?what) ?what=ball: active" in panel.events.toPlainText())


def test_a_stream_that_is_not_possible_waits_and_says_for_what(qtbot, window, remote):
    panel = _ask_for(qtbot, window, "Weather(today)")
    click(qtbot, panel.acquire)
    until(qtbot, lambda: len(panel.table.names()) == 1)
    why = "no plan for Weather(today): nothing supplies Weather(today)"
    assert cells_of(panel.table, 0)[2] == f"pending: {why}"
    until(qtbot, lambda: "c_Weather(today)" in vertex_keys(window))
    item = window.graph.view.scene().vertices["c_Weather(today)"]
    assert item.stroke().style() == Qt.DashLine and item.fill() == item.colours.paper
    assert item.vertex.label == "Weather(today)\nnothing supplies Weather(today)"
    tip = window.graph.view.scene().facts.tip_of(item)
    assert "waits until it can be made: nothing supplies Weather(today)" in tip
    until(qtbot, lambda: "waits, no plan for Weather(today)" in window.line.text)
    remote.client.add_transformation(_WEATHER)
    remote.client.settle()
    until(qtbot, lambda: "c_Weather(today)" not in vertex_keys(window))
    panel = _ask_for(qtbot, window, "no term(")
    click(qtbot, panel.acquire)
    until(qtbot, lambda: "acquire no term(: " in window.line.text)
    assert len(panel.table.names()) == 1 and no_boxes()


def test_a_formula_is_required_of_a_stream(qtbot, window, remote):
    panel = _ask_for(qtbot, window, "Track(ball)")
    qtbot.keyClicks(panel.require, "it.pose.x <")
    assert panel.request().require == "it.pose.x <" and "'it'" in panel.require.toolTip()
    qtbot.keyClick(panel.require, Qt.Key_Return)
    until(qtbot, lambda: "line 1, column 12: expected a formula" in panel.plan.text)
    click(qtbot, panel.acquire)
    refusal = "acquire Track(ball): formula, line 1, column 12: expected a formula"
    until(qtbot, lambda: window.line.text.startswith(refusal))
    panel.require.setText(" it.pose.x < 2 ")
    click(qtbot, panel.acquire)
    until(qtbot, lambda: panel.table.names())
    assert panel.request().require == "it.pose.x < 2"


def test_why_a_part_is_not_available_is_shown_in_full(qtbot, window, remote):
    remote.client.add_transformation(FORMULAS.read_text())
    remote.client.acquire_stream(StreamRequest("RawYUV(nao)", client_id="test"))
    remote.client.settle()  # the verdicts are acquired
    remote.client.settle()  # and heard
    table = window.streams.table
    until(qtbot, lambda: len(table.names()) == 2)
    clients = {cells_of(table, row)[1]: cells_of(table, row)[5] for row in (0, 1)}
    assert clients == {"RawYUV(nao)": "test", "Holds(charged, nao)": "dyknow_manager"}
    remote.client.host.decide("/charged_1/holds", False, "battery.percentage = 0.19 at 12.2")
    remote.client.settle()

    def tip():
        row = [cells_of(table, row)[1] for row in range(2)].index("RawYUV(nao)")
        return table.model().index(row, 2).data(Qt.ToolTipRole)

    until(qtbot, lambda: "is not available" in tip())
    assert Qt.mightBeRichText(tip())  # such tips are wrapped
    assert "/bottom_camera_1 is not available: Holds(charged, nao) is FALSE since" in tip()
    assert "(battery.percentage = 0.19 at 12.2)" in tip()


def test_the_plan_that_is_shown_is_the_present_one(qtbot, window, remote):
    panel = _ask_for(qtbot, window, "FieldPosition(ball)")
    click(qtbot, panel.acquire)
    until(qtbot, lambda: "FieldPosition(ball)  on /" in panel.plan.text)
    (stream,) = window.monitor.streams
    first = panel.plan.ways
    source = first[0][1].nodelet
    assert source in stream.nodelets
    click(qtbot, panel.preview)
    until(qtbot, lambda: "proven least" in panel.plan.text)
    panel.table.selectRow(0)
    assert panel.plan.ways == first
    remote.client.destroy(source)
    remote.client.settle()
    until(qtbot, lambda: f" as {source}" not in panel.plan.text)
    until(qtbot, lambda: "runs as /" in panel.plan.text)
    assert not panel.plan.wordWrap()


def test_a_plan_is_a_tree_that_leads_to_the_graph_and_can_be_copied(qtbot, window, remote):
    remote.client.destroy("/field/tracker")
    panel = _ask_for(qtbot, window, "Track(ball)")
    click(qtbot, panel.preview)
    until(qtbot, lambda: len(panel.plan.ways) > 1)
    first = panel.plan.topLevelItem(0)
    assert [first.text(column) for column in range(3)] == ["Track(ball)", "1", "proven least"]
    tracker = first.child(0)
    assert [tracker.text(column) for column in range(3)] == ["tracker.track", "1", "new"]
    source = tracker.child(0)
    assert source.text(0) == "position ← ceiling_camera.field_position"
    assert first.isExpanded() and not panel.plan.topLevelItem(1).isExpanded()
    costs = [float(way[0].cost) for way in panel.plan.ways[1:]]
    assert costs == sorted(costs) and min(costs) >= 1.0
    assert [way[0].what for way in panel.plan.ways[1:]] == ["without ceiling_camera"]
    panel.plan.setCurrentItem(source)
    assert window.selection.nodelets == ["/field/ceiling_camera"]
    qtbot.keyClick(panel.plan, Qt.Key_C, Qt.ControlModifier)
    assert "  tracker.track  1  new\n    position ←" in QGuiApplication.clipboard().text()


def test_a_plan_is_drawn_over_the_graph_until_it_is_made_or_left(qtbot, window, remote):
    scene, ghost = window.graph.view.scene(), "g_tracker"
    remote.client.destroy("/field/tracker")
    until(qtbot, lambda: "n_/field/tracker" not in vertex_keys(window))
    panel = _ask_for(qtbot, window, "Track(ball)")
    panel.exclude.setText("ceiling_camera")
    click(qtbot, panel.preview)
    until(qtbot, lambda: ghost in vertex_keys(window))
    stroke = scene.vertices[ghost].stroke()
    assert (stroke.style(), stroke.color()) == (Qt.DashLine, scene.colours.text)
    assert scene.vertices[ghost].vertex.label == "tracker\ncost 1"
    source = scene.vertices["n_/nao1/localization"]
    assert source.tone is Tone.KEPT and source.fill() == source.colours.kept
    (arrow,) = (edge for edge in scene.edges if edge.head == ghost)
    assert arrow.tail == "t_/field/ball" and scene.edges[arrow].is_dead
    until(qtbot, lambda: is_settled(window))
    view, planned = window.graph.view, scene.edges[arrow]
    middle = view.mapFromScene(planned.path.pointAtPercent(0.5))
    assert planned in view.items(middle) and view._target_at(middle) is None
    scene.highlight("n_/nao1/resize")
    scene.highlight(None)
    assert source.tone is Tone.KEPT
    window.tabs.setCurrentWidget(window.active)
    until(qtbot, lambda: ghost not in vertex_keys(window))
    until(qtbot, lambda: source.tone is Tone.NONE)
    window.tabs.setCurrentWidget(panel)
    until(qtbot, lambda: ghost in vertex_keys(window) and source.tone is Tone.KEPT)
    click(qtbot, panel.acquire)
    until(
        qtbot, lambda: "n_/tracker_1" in vertex_keys(window) and ghost not in vertex_keys(window)
    )
    undo(qtbot, window)
    until(qtbot, lambda: remote.client.list_streams()[0].state.name == "RELEASED")


def test_what_a_new_plan_drops_is_struck_out(qtbot, window, remote):
    panel = _ask_for(qtbot, window, "FieldPosition(ball)")
    panel.exclude.setText("localization")
    remote.client.alter("/field/ceiling_camera", state=State.RUNNING)
    click(qtbot, panel.acquire)
    until(qtbot, lambda: bool(panel.table.names()) and not window.monitor.is_changing)
    (stream,) = window.monitor.streams
    client, scene = remote.client, window.graph.view.scene()
    client.replan_stream = lambda claim, dry_run: Replanned(
        ("tracker",),
        (),
        1.0,
        f"{stream.tag}: cost 1 (proven least)\n└─ t.p [?robot=nao1] (new, cost 1)",
        "",
    )
    panel.table.choose(panel.table.names())
    click(qtbot, panel.replan)
    until(qtbot, lambda: "Used no longer" in panel.plan.text)
    dropped = scene.vertices[f"n_{stream.nodelets[0]}"]
    assert dropped.tone is Tone.DROPPED
    ghost = "g_t ?robot=nao1"
    until(qtbot, lambda: ghost in vertex_keys(window))
    assert scene.vertices[ghost].vertex.label == "t\n?robot=nao1\ncost 1"
    panel.table.choose(panel.table.names())
    panel._show_way(stream.claim_id)
    until(qtbot, lambda: ghost not in vertex_keys(window))
    assert dropped.tone is Tone.NONE


def test_an_answer_that_comes_late_is_not_shown(qtbot, window, monkeypatch):
    panel, asked, done, planned = _ask_for(qtbot, window, "Track(ball)"), [], [], []
    monkeypatch.setattr(window.monitor, "ask", lambda question, then, *failed: asked.append(then))

    def do(change):
        done.append(change.text)
        window.monitor.settled.emit()

    monkeypatch.setattr(window.monitor, "do", do)
    panel.planned.connect(planned.append)

    def question(button):
        click(qtbot, button)
        return asked[-1]

    first, second = question(panel.preview), question(panel.preview)
    second(SimpleNamespace(plan="newer: cost 1", warnings=()))
    first(SimpleNamespace(plan="older: cost 1", warnings=()))
    assert panel.plan.text.startswith("newer")
    for go_on in (
        lambda: qtbot.keyClicks(panel.tag, "x"),
        lambda: panel.choose(["a claim"]),
        lambda: window.tabs.setCurrentWidget(window.active),
    ):
        third = question(panel.acquire)
        go_on()
        planned.clear()
        third(SimpleNamespace(plan="oldest: cost 1", warnings=()))
        assert not any(planned)
    assert done == ["acquire Track(ball)", "acquire Track(ball)x", "acquire Track(ball)x"]


def test_a_tag_is_completed_within_its_parentheses():
    tags = [
        "FieldPosition(ball)",
        "HSV(?robot, ?camera)",
        "RawYUV(nao1, bottom)",
        "RawYUV(nao1, top)",
    ]
    for text, found in (
        ("yuv", ["RawYUV(nao1, bottom)", "RawYUV(nao1, top)"]),
        ("FieldPosition(ba", ["FieldPosition(ball)"]),
        ("RawYUV(", ["RawYUV(bottom", "RawYUV(nao1", "RawYUV(top", "RawYUV(ball"]),
        ("HSV(nao1, B", ["HSV(nao1, ball)", "HSV(nao1, bottom)"]),
        ("RawYUV(nao1, t", ["RawYUV(nao1, top)"]),
        ("Track(?", []),
        ("RawYUV(nao1, top)", ["RawYUV(nao1, top)"]),
    ):
        assert tag_completions(text, tags) == found, text


def _replanned(qtbot, window, remote, request):
    """Show how a stream would be made again."""
    panel = show(window, window.streams)
    claim_id = remote.client.acquire_stream(request).claim_id
    until(qtbot, lambda: claim_id in panel.table.names())
    panel.table.choose([claim_id])
    click(qtbot, panel.replan)
    until(qtbot, lambda: remote.client.calls.count(("plan_stream", claim_id)) == 1)
    return panel


@pytest.mark.parametrize(
    ("exclude", "others"), [((), ["without ceiling_camera"]), (("localization",), [])]
)
def test_replan_lists_the_next_best_ways_within_the_claims_limits(
    qtbot, window, remote, exclude, others
):
    remote.client.alter("/field/ceiling_camera", state=State.RUNNING)
    request = StreamRequest("FieldPosition(ball)", exclude=exclude)
    panel = _replanned(qtbot, window, remote, request)
    until(qtbot, lambda: [way[0].what for way in panel.plan.ways[2:]] == others)


def test_the_cheapest_way_is_taken_after_asking_and_what_stays_is_not_struck_out(
    qtbot, window, remote
):
    panel = _replanned(qtbot, window, remote, StreamRequest("Track(ball)"))
    assert panel.plan.text.startswith("Track(ball) [nav_msgs/Path]  0")
    assert "Used no longer" not in panel.plan.text
    assert len(window.monitor.streams[0].nodelets) > 1
    assert window.line.text == "Switch Track(ball) to this plan, which spawns nothing?"
    click(qtbot, window.line.yes)
    until(qtbot, lambda: window.line.text == "done: replan Track(ball)")
