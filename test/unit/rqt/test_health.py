# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The master and the manager: gone, silent, strange, and back; and what else is not well."""

from __future__ import annotations

import threading
import time

import pytest
from clocks import HandClock, eventually, wait_for
from python_qt_binding.QtCore import QPointF, Qt
from python_qt_binding.QtGui import QPalette
from unit.cli.fake_client import cases
from unit.rqt.hands import CEILING, create, is_ready, show, topic, undo, until, vertex_keys
from unit.rqt.test_colours import contrast

from dyknow.errors import StreamRefused
from dyknow.model.graph import PortRef, SpawnRequest, State
from dyknow.model.streams import ClaimState, StreamRequest, StreamStatus
from dyknow.periodic import RunningClock
from dyknow_rqt.canvas.appearance import colours_of
from dyknow_rqt.graph.changes import Change, protect, spawn
from dyknow_rqt.graph.health import Contact, ills_of
from dyknow_rqt.graph.measurements import PortRate
from dyknow_rqt.graph.snapshot import Snapshot
from dyknow_rqt.monitoring.heartbeat import Heartbeat
from dyknow_rqt.monitoring.simulated import soccer
from dyknow_rqt.screenshots import dark_palette

_MASTER = "http://robot:11311"
_STEPS = {
    "manager": lambda contact: contact.hear_manager(),
    "manager silent": lambda contact: contact.miss_manager(is_gone=False),
    "manager gone": lambda contact: contact.miss_manager(is_gone=True),
    "master": lambda contact: contact.hear_master(is_known=True),
    "new master": lambda contact: contact.hear_master(is_known=False),
    "no master": lambda contact: contact.miss_master(is_gone=True),
    "master late": lambda contact: contact.miss_master(is_gone=False),
}


#: Steps and seconds; whether the manager's state is current, and all is sound; the short and the
#: whole status, with MASTER, SHORT and FINE as they are below.
STATUS = """
 |  | waiting for /manager | SHORT
no master, manager gone, 60 |  | no ROS master at MASTER | SHORT; waiting for /manager
master, manager, 1.5 | current sound | FINE | SHORT; ROS master at MASTER
master, manager, master late | current sound | FINE | SHORT; ROS master at MASTER
manager, 7.2, master, manager silent |  | /manager silent for 7 s | OLD
manager, 119, master, manager silent |  | /manager silent for 119 s | OLD
manager, 150, master, manager silent |  | /manager silent for 2 min | OLD
manager, 9000, master, manager silent |  | /manager silent for 2 h | OLD
master, manager, manager gone, 1 |  | /manager gone for 1 s | OLD
master, manager, manager gone, manager | current sound | FINE | SHORT; ROS master at MASTER
master, 3, manager | current | no ROS master at MASTER for 3 s | SHORT; ANSWERS
master, 3, manager, manager gone |  | /manager gone for 0 s | no ROS master at MASTER for 3 s; OLD
manager, new master | current | the ROS master at MASTER does not know /manager | SHORT; REGISTERS
"""
_TEXTS = {
    "OLD": "SHORT: what is shown is that old",
    "ANSWERS": "/manager answers; nothing new can be asked for",
    "REGISTERS": "/manager answers: a new roscore; its nodes are registered again within seconds",
    "FINE": f"/manager answers since {time.strftime('%H:%M:%S', time.localtime(0.0))}",
    "MASTER": _MASTER,
}


@pytest.mark.parametrize(("steps", "marks", "short", "text"), cases(STATUS))
def test_the_status_says_who_answers_and_since_when(steps, marks, short, text):
    clock = HandClock(100.0)
    contact = Contact("/manager", _MASTER, clock, now=lambda: 0.0)
    for step in filter(None, steps.split(", ")):
        if step in _STEPS:
            _STEPS[step](contact)
        else:
            clock.time += float(step)
    for word, meaning in _TEXTS.items():
        short, text = short.replace(word, meaning), text.replace(word, meaning)
    said = (short, text.replace("SHORT", short))
    assert contact.status() == ("current" in marks, "sound" in marks, *said)


def test_a_window_that_was_stopped_or_starved_takes_nobody_for_silent():
    wall = HandClock(100.0)
    contact = Contact("/manager", _MASTER, RunningClock(wall), now=lambda: 0.0)
    contact.hear_manager()
    contact.hear_master(is_known=True)
    for _ in range(3):
        wall.time += 60.0  # nothing can have come meanwhile
        assert contact.status().is_sound
    beats = 0
    while contact.status().is_current:
        wall.time += 0.25
        beats += 1
    assert beats * 0.25 < 2.0


def test_answers_are_noted_while_the_window_is_at_work(qtbot, remote):
    heart = Heartbeat(remote)
    heart._beat()
    eventually(lambda: heart.contact.status().is_sound)  # Qt does not run meanwhile
    assert not heart.status.is_sound
    heart._beat()
    assert heart.status.is_sound
    heart.close()


# In the window


def contact_of(window):
    return window.line.contact.text()


def is_grey(window):
    """Whether drawing and tables are; both or none."""
    drawn = window.graph.view.scene().vertices["n_/nao1/resize"].colours.text
    listed = window.active.table.palette().color(QPalette.Text)
    greys = [colour != window.palette().color(QPalette.Text) for colour in (drawn, listed)]
    assert greys[0] == greys[1]
    return greys[0]


def is_fine(window):
    told = "/dyknow_manager answers since" in contact_of(window)
    return told and not window.graph.sign.isVisible() and not is_grey(window)


def corner_of(widget):
    """The colour that is seen behind its text."""
    return widget.grab().toImage().pixelColor(2, 2)


def rates(window):
    arrows = window.graph.view.scene().edges.values()
    return [arrow.traffic for arrow in arrows if arrow.traffic is not None]


def test_a_manager_that_is_gone_is_told_greyed_and_found_again(qtbot, window, remote):
    sign = window.graph.sign
    until(qtbot, lambda: is_fine(window) and rates(window))
    remote.client.is_up = False
    until(qtbot, lambda: "⚠ /dyknow_manager gone for" in contact_of(window))
    assert sign.isVisible() and "what is shown is that old" in sign.text()
    assert is_grey(window)
    until(qtbot, lambda: not rates(window))
    assert not window.health.isVisible()
    window.streams.tag.setText("Track(ball)")
    window.streams.preview.click()
    assert "/dyknow_manager gone for" in window.streams.plan.text
    window.create_.begin("tracker")
    window.create_.create.click()
    assert window.line.text.startswith("create /tracker: /dyknow_manager gone for")
    assert window.create_.create.isEnabled() and window.create_.create.text() == "Create"
    window.monitor.do(protect("/field/tracker", True))
    assert window.line.text.startswith("protect /field/tracker: /dyknow_manager gone for")
    remote.client.is_up = True
    until(qtbot, lambda: is_fine(window) and rates(window) and window.health.isVisible())
    create(qtbot, window, "/field/second")


def test_what_is_lost_looks_dead_with_its_topic_and_arrows(qtbot, remote, scene):
    lost, topic = "/nao1/subsampler", scene.vertices["t_/nao1/subsampler/hsv"]
    dead = [e for e in scene.edges if topic.vertex.key in e or f"n_{lost}" in e]
    after = next(e for e in dead if e.tail == topic.vertex.key)
    until(qtbot, lambda: scene.edges[after].traffic is not None)
    alive = next(e for e in scene.edges if e.tail == "n_/field/tracker")
    for state, is_dead in ((State.LOST, True), (State.RUNNING, False)):
        remote.client.alter(lost, state=state)
        grey = scene.vertices["n_/nao1/resize"].colours.box_line
        until(qtbot, lambda on=is_dead: scene.edges[after].is_dead is on)
        steps = (scene._show_states, scene._show_all_traffic)
        until(qtbot, lambda steps=steps: not any(map(scene.slices.is_wanted, steps)))
        for edge in dead:
            assert (scene.edges[edge].stroke().color() == grey) is is_dead
            assert "Hz" not in scene.edges[edge].label or not is_dead
        assert (topic.fill() == topic.colours.paper) is is_dead and topic._badge() == ""
        assert not scene.edges[alive].is_dead
        until(qtbot, lambda on=is_dead: (scene.edges[after].traffic is None) is on)
    remote.publishers = {topic.vertex.name: ["/bag"]}
    remote.client.alter(lost, state=State.LOST)
    until(qtbot, lambda: scene.edges[next(e for e in dead if e.head == topic.vertex.key)].is_dead)
    until(qtbot, lambda: not scene.edges[after].is_dead)


def test_the_master_goes_and_another_one_does_not_know_the_manager(qtbot, window, remote):
    window.graph.bar.choose("nodes", 1)
    until(qtbot, lambda: "p_/team_view" in vertex_keys(window))
    sign = window.graph.sign
    remote.has_master = False
    until(qtbot, lambda: "⚠ no ROS master at http://localhost:11311" in contact_of(window))
    assert "/dyknow_manager answers; nothing new can be asked for" in sign.text()
    assert not is_grey(window), "what the manager tells is true"
    assert "p_/team_view" in vertex_keys(window)
    remote.client.spawn("tracker", "/field/second")
    until(qtbot, lambda: "n_/field/second" in vertex_keys(window))
    remote.has_master, remote.address = True, ""
    until(qtbot, lambda: "does not know /dyknow_manager" in contact_of(window))
    assert "a new roscore;" in sign.text()
    remote.address = "rosrpc://localhost:40002"
    until(qtbot, lambda: not sign.isVisible())


def test_another_manager_of_the_name_is_read_from_the_beginning_without_undo(
    qtbot, window, remote
):
    create(qtbot, window, "/first")
    remote.address = "rosrpc://localhost:40002"  # of its next life
    until(qtbot, lambda: window.monitor.heart._address == remote.address)
    until(qtbot, lambda: is_ready(window))
    assert window.graph.bar.undo.isEnabled()
    remote.client.remove_transformation("recorder")
    until(qtbot, lambda: "recorder" not in window.library.table.names())
    other = soccer()
    other.client.remove_transformation("tracker")
    other.client.destroy("/field/tracker")
    revisions = [each.client.get_model().library_revision for each in (remote, other)]
    assert revisions[0] == revisions[1], "that alone does not tell them apart"
    remote.client.core, remote.client.host = other.client.core, other.client.host
    remote.address = "rosrpc://localhost:40003"
    until(qtbot, lambda: "n_/field/tracker" not in vertex_keys(window))
    until(qtbot, lambda: "tracker" not in window.library.table.names())
    assert "recorder" in window.library.table.names()
    until(qtbot, lambda: not window.graph.bar.undo.isEnabled())
    assert window.monitor.history.texts == ("", "")


def protected(remote, name):
    """Whether a nodelet was to be protected, or released."""
    return ("set_protection", name) in remote.client.calls


def slow_change():
    """A change that makes a nodelet, and the event when it may."""
    may = threading.Event()

    def steps(present):
        wait_for(may)
        return spawn(SpawnRequest("tracker", "/second")).steps(present)

    return Change("slow", steps), may


def test_a_link_that_is_renewed_during_a_change_leaves_all_that_can_be_undone(
    qtbot, window, remote, monkeypatch
):
    monitor, graph, is_made = window.monitor, remote.graph, threading.Event()
    slow, may = slow_change()
    create(qtbot, window, "/first")
    monkeypatch.setattr(remote, "graph", lambda: wait_for(is_made) or graph())
    monitor.do(slow)
    monitor._follow_link(True)
    may.set()
    until(qtbot, lambda: not monitor.is_changing)
    is_made.set()
    until(qtbot, lambda: monitor.snapshot.nodelet("/second") is not None)
    assert not monitor._is_another and len(monitor.history._done) == 2


def test_what_others_change_while_the_manager_is_silent_leaves_all_that_can_be_undone(
    qtbot, window, remote, monkeypatch
):
    monitor, graph, is_made = window.monitor, remote.graph, threading.Event()
    create(qtbot, window, "/first")
    monkeypatch.setattr(remote, "graph", lambda: wait_for(is_made) or graph())
    monitor._follow_link(True)
    remote.client.spawn("tracker", "/second")
    is_made.set()
    until(qtbot, lambda: is_ready(window) and monitor.snapshot.nodelet("/second") is not None)
    undo(qtbot, window)
    until(qtbot, lambda: monitor.snapshot.nodelet("/first") is None)


def test_another_manager_is_known_before_the_next_beat(qtbot, window, remote, monkeypatch):
    monitor, other = window.monitor, soccer()
    create(qtbot, window, "/first")
    monitor.heart._timer.stop()
    until(qtbot, lambda: not monitor.heart._calls.is_calling)
    remote.client.core, remote.client.host = other.client.core, other.client.host
    remote.address = "rosrpc://localhost:40002"
    monitor._follow_link(True)
    until(qtbot, lambda: is_ready(window))
    assert monitor.history.texts == ("", "")


def test_models_that_waited_for_a_new_link_take_nothing_back(qtbot, window, remote):
    monitor, before = window.monitor, remote.client.get_model()
    create(qtbot, window, "/first")
    monitor._hear(before)  # it waits for its turn to be drawn
    monitor._follow_link(True)
    monitor._hear(before)
    monitor._take_heard()
    assert monitor.snapshot.nodelet("/first") is not None
    until(qtbot, lambda: is_ready(window))
    assert monitor.history.texts[0] and monitor.snapshot.nodelet("/first") is not None


def test_no_change_begins_before_it_is_known_whose_graph_it_changes(qtbot, window, remote):
    create(qtbot, window, "/first")
    window.monitor._follow_link(True)
    window.monitor.do(protect("/first", True))
    assert not protected(remote, "/first")
    assert "protect /first: waiting for the graph to be read" in window.line.text
    until(qtbot, lambda: remote.graph().nodelet("/first").is_protected)
    window.monitor.undo()
    window.monitor.undo()
    until(qtbot, lambda: window.monitor.snapshot.nodelet("/first") is None)


def test_changes_wait_for_the_one_before_them(qtbot, window, remote):
    """Each begins from the graph that the one before it leaves, and is undone alone."""
    monitor, (slow, may) = window.monitor, slow_change()
    monitor.do(slow)
    monitor.do(protect("/second", True))
    assert "protect /second: waiting for the change before it" in window.line.text
    monitor.undo()
    monitor.redo()
    monitor.redo()  # there is nothing left: that holds up nothing
    monitor.do(spawn(SpawnRequest("tracker", "/third")))
    assert monitor.is_changing and not protected(remote, "/second")
    may.set()
    until(qtbot, lambda: not monitor.is_changing)
    assert remote.graph().nodelet("/second").is_protected and remote.graph().nodelet("/third")
    assert [each.change.text for each in monitor.history._done] == [
        "slow",
        "protect /second",
        "create /third",
    ]


def _drop(window, sink):
    window.graph.view.dropped.emit(CEILING, sink, QPointF())


def _click_connect(window, sink):
    panel = show(window, window.connect_)
    panel.source.choose(CEILING)
    panel.sink.choose(sink)
    panel.connect.click()


@pytest.mark.parametrize("connect", [_drop, _click_connect])
def test_a_connection_that_waits_adds_to_the_one_before_it(qtbot, window, remote, connect):
    first, second = (PortRef(f"/field/{name}", "position") for name in ("first", "second"))
    for ref in (first, second):
        create(qtbot, window, ref.nodelet)
    monitor, (slow, may) = window.monitor, slow_change()
    monitor.do(slow)
    connect(window, first)
    connect(window, second)
    may.set()
    until(qtbot, lambda: not monitor.is_changing)
    (shared,) = {topic(remote, ref) for ref in (CEILING, first, second)}
    undo(qtbot, window)
    until(qtbot, lambda: not topic(remote, second))
    assert topic(remote, first) == topic(remote, CEILING) == shared


def test_changes_that_wait_for_a_manager_that_falls_silent_are_refused(qtbot, window, remote):
    monitor, (slow, may), refused = window.monitor, slow_change(), []
    monitor.failed.connect(refused.append)
    monitor.do(slow)
    monitor.do(protect("/field/tracker", True))
    remote.client.is_up = False
    until(qtbot, lambda: not monitor.is_linked)
    may.set()
    until(qtbot, lambda: not monitor.is_changing)
    assert any(each.startswith("protect /field/tracker: ") for each in refused)
    remote.client.is_up = True
    until(qtbot, lambda: is_ready(window))
    assert not remote.graph().nodelet("/field/tracker").is_protected


def test_warnings_are_readable_in_the_light_and_in_the_dark(qtbot, window, remote, scene):
    remote.client.is_up = False
    sign, contact = window.graph.sign, window.line.contact
    until(qtbot, sign.isVisible)
    for palette in (QPalette(), dark_palette()):
        window.setPalette(palette)
        assert corner_of(sign) == colours_of(palette).alarm
        drawn = scene.vertices["n_/nao1/resize"].colours
        assert scene.vertices["n_/nao1/resize"].ports["image"].colours == drawn
        assert scene.backgroundBrush().color() == drawn.paper == palette.color(QPalette.Base)
        background = window.palette().color(QPalette.Window)
        for text, ground in (
            (sign.palette().color(QPalette.WindowText), corner_of(sign)),
            (contact.palette().color(QPalette.WindowText), background),
            (drawn.text, drawn.nodelet),
        ):
            assert contrast(text, ground) >= 4.5, (text.name(), ground.name())


def test_errors_are_in_the_colour_of_the_theme(window):
    line, edit = window.line, window.graph.bar.nodelets
    edit.setText("(")
    for palette in (dark_palette(), QPalette()):
        window.setPalette(palette)
        for widget, role in ((line._text, QPalette.WindowText), (edit, QPalette.Text)):
            assert widget.palette().color(role) == colours_of(palette).alarm
    edit.clear()
    window.setPalette(dark_palette())
    line.note("mended")
    for widget, role in ((line._text, QPalette.WindowText), (edit, QPalette.Text)):
        assert widget.palette().color(role) == window.palette().color(role)


def test_the_worst_comes_first_and_each_once(remote):
    streams = [
        StreamStatus(state.name, "test", "Tag(a)", "", "", state, "", (), 0.0)
        for state in ClaimState
    ]
    traffic = {
        PortRef("/nao1/recorder", "in"): PortRate(1.0, 2.0, 1, 2),
        PortRef("/nao1/resize", "image"): PortRate(1.0, 2.0, 1, 2),
        PortRef("/nao1/subsampler", "yuv"): PortRate(1.0, 0.0, 1, 0),
    }
    ills = ills_of(Snapshot(remote.graph().nodelets), streams, traffic)
    assert [(ill.word, ill.nodelet or ill.claim) for ill in ills] == [
        ("lost", "/nao1/recorder"),
        ("failed", "/field/ceiling_camera"),
        ("failed", "FAILED"),
        ("degraded", "DEGRADED"),
        ("degraded", "RECOVERING"),
        ("slow", "/nao1/resize"),
        ("waiting", "PENDING"),
    ]
    assert ills_of(Snapshot(), [], {}) == []


def test_the_line_counts_what_is_not_well_and_leads_there(qtbot, window, remote):
    health, line = window.health, window.line
    until(qtbot, lambda: "1 slow" in health.text())
    assert "1 lost" in health.text() and "1 failed" in health.text()
    assert "lost: /nao1/recorder" in health.toolTip() and line.isAncestorOf(health)
    remote.client.alter("/nao1/resize", state=State.LOST)
    until(qtbot, lambda: "2 lost" in health.text())
    health.setFocus()
    health.focusNextPrevChild(True)  # to its first link
    qtbot.keyClick(health, Qt.Key_Return)
    assert window.selection.nodelets == ["/nao1/recorder"]
    health.linkActivated.emit("lost")
    assert window.selection.nodelets == ["/nao1/resize"]
    health.linkActivated.emit("lost")
    assert window.selection.nodelets == ["/nao1/recorder"]
    seen = set()
    for _ in range(4):
        qtbot.keyClick(window, Qt.Key_F8)
        seen.update(window.selection.nodelets)
    assert {"/nao1/recorder", "/nao1/resize", "/field/ceiling_camera"} <= seen


def test_what_is_published_on_no_topic_does_not_make_a_nodelet_slow(qtbot, window, remote):
    until(qtbot, lambda: "1 slow" in window.health.text())
    remote.client.rates["/nao1/subsampler", "bgr"] = (0.0, 30.0)
    counted = []
    window.monitor.measured.connect(lambda traffic: counted.append(traffic))
    until(qtbot, lambda: len(counted) > 6)
    assert PortRef("/nao1/subsampler", "bgr") not in window.monitor.traffic
    assert "1 slow" in window.health.text()


def test_a_claim_that_waits_is_led_to_in_its_tab(qtbot, window, remote):
    with pytest.raises(StreamRefused) as refusal:
        remote.client.acquire_stream(StreamRequest("Weather(today)", client_id="test"))
    claim = refusal.value.claim_id
    until(qtbot, lambda: "1 waiting" in window.health.text())
    window.graph.bar.panel.trigger()
    window.health.linkActivated.emit("waiting")
    assert window.tabs.currentWidget() is window.streams and window.streams.isVisible()
    assert window.selection.claims == {claim} == set(window.streams.table.chosen())
    assert window.streams.plan.ways[0][0].what == "Weather(today)"
