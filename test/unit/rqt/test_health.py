# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Health at a glance: problems are counted, and links lead to them one by one."""

from __future__ import annotations

import pytest
from python_qt_binding.QtCore import Qt
from unit.rqt.hands import until

from dyknow.errors import StreamRefused
from dyknow.model.graph import PortRef, State
from dyknow.model.streams import ClaimState, StreamRequest, StreamStatus
from dyknow_rqt.graph.health import ills_of
from dyknow_rqt.graph.rates import PortRate
from dyknow_rqt.graph.snapshot import Snapshot


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
