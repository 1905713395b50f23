# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The demonstration's story: the track's figures, changes of the graph, and its pictures."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from dyknow.model.graph import Model, NodeletStatus, PortState, State
from dyknow_demo.telling import Stretch, Timeline, Track, changes, draw, to_dot


def nodelet(name, state=State.RUNNING, **ports):
    """A nodelet with in-ports, and one out-port ``out``."""
    own = [PortState(port, "in", topic=topic) for port, topic in ports.items() if port != "out"]
    own.append(PortState("out", "out", topic=ports.get("out", f"{name}/out")))
    return NodeletStatus(name, "", "/m", False, False, False, state, "", tuple(own))


def model(*nodelets):
    return Model(1, 1, nodelets, ())


BEFORE = model(nodelet("/ns/eye"), nodelet("/ns/tracker", image="/ns/eye/out", out="/goal"))
AFTER = model(
    nodelet("/ns/ceiling"),
    nodelet("/ns/late", State.STARTING),
    nodelet("/ns/tracker", image="/ns/ceiling/out", out="/goal"),
)


def test_rate_error_and_pause_of_a_stretch():
    track = Track(10.0, lambda stamp: np.array([stamp, 0.0, 0.0]))
    for step in range(11):
        arrival = 10.5 + 0.1 * step
        track.note(arrival, arrival - 0.02, arrival, 0.02 * (step == 10))
    found = track.stretch(11.5, 10.5)
    assert (found.count, round(found.rate), round(found.pause, 6)) == (11, 11, 0.5)
    assert math.isclose(found.median, 0.02, abs_tol=1e-9)
    assert math.isclose(found.worst, math.hypot(0.02, 0.02), abs_tol=1e-9)
    whole = track.stretch(12.5)
    assert (whole.count, round(whole.pause, 6)) == (11, 1.0)


def test_without_positions_all_of_it_is_a_pause():
    found = Track(10.0, lambda stamp: np.zeros(3)).stretch(13.0)
    assert (found.count, found.rate, found.pause) == (0, 0.0, 3.0)
    assert math.isnan(found.median) and math.isnan(found.worst)


def test_a_claim_is_kept_if_positions_are_right_and_never_too_far_apart():
    assert Stretch(100, 20.0, 0.04, 0.1, 0.5).shortcomings(0.5) == []
    late = Stretch(100, 20.0, 0.04, 0.1, 2.25).shortcomings(2.0)
    assert late == ["the position was lost for 2.25 s, not 2 s"]
    wrong = Stretch(100, 20.0, 0.5, 0.9, 0.5).shortcomings(2.0)
    assert wrong == ["the positions are wrong by 0.50 m"]
    none = Track(0.0, lambda stamp: np.zeros(3)).stretch(3.0)
    assert len(none.shortcomings(2.0)) == 2


def test_what_came_went_and_was_re_wired_is_told():
    assert changes(BEFORE, AFTER, "/ns") == [
        "+ ceiling",
        "  tracker.image <- ceiling/out (was eye/out)",
        "- eye",
    ]
    assert changes(model(), BEFORE) == [
        "+ ns/eye",
        "+ ns/tracker",
        "  ns/tracker.image <- ns/eye/out",
        "  ns/tracker.out -> goal",
    ]
    assert changes(AFTER, AFTER) == []


def test_a_picture_shows_who_was_kept_came_and_went(tmp_path):
    needed = {"/ns/tracker", "/ns/ceiling"}
    dot = to_dot("A title", AFTER, BEFORE, needed, "/goal", "/ns")
    assert '"n/ns/tracker" [label="tracker", style=filled, fillcolor="#cfe2f3"]' in dot
    assert '"n/ns/ceiling" [label="ceiling", style=filled, fillcolor="#c6e7c8"]' in dot
    assert '"n/ns/eye" [label="eye", style=dashed' in dot
    assert '"t/ns/ceiling/out" -> "n/ns/tracker" [label="image"]' in dot
    assert '"t/goal" [label="/goal", shape=box, style=bold]' in dot
    assert "late" not in dot
    png, svg = draw(dot, tmp_path / "new", "moment")
    assert png.read_bytes().startswith(b"\x89PNG")
    assert "A title" in svg.read_text()


def test_a_nodelet_that_the_stream_needs_no_more_is_grey():
    dot = to_dot("", BEFORE, BEFORE, {"/ns/tracker"}, "/goal")
    assert '[label="ns\\n/eye", style=filled, fillcolor="#eeeeee"]' in dot


def test_the_verdicts_and_the_picture(tmp_path: Path) -> None:
    track = Track(100.0, lambda stamp: np.array([1.0, 2.0, 0.1]))
    timeline = Timeline(100.0, track)
    assert timeline.values == []
    track.note(100.5, 0.0, 1.03, 2.04)
    verdicts = ["TRUE", "TRUE", "UNKNOWN", "TRUE", "FALSE", "FALSE", "TRUE"]
    news = [timeline.note(100.0 + at, each, 0.3) for at, each in enumerate(verdicts)]
    assert news == [True, False, True, True, True, False, True]
    assert timeline.values == ["TRUE", "FALSE", "TRUE"]
    png, svg = timeline.draw(tmp_path, "story")
    assert png.read_bytes().startswith(b"\x89PNG") and "<svg" in svg.read_text()
