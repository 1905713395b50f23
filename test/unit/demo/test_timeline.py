# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The time-line of the story."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dyknow_demo.telling import Track
from dyknow_demo.timeline import Timeline


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
