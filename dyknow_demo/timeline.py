# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The story as a picture: the verdict over time, beside the battery and the tracking's error."""

from __future__ import annotations

from itertools import groupby
from operator import itemgetter
from pathlib import Path

from dyknow_demo.telling import Track

_COLOURS = {"TRUE": "#8fcf8f", "FALSE": "#e09090", "UNKNOWN": "#cccccc"}


class Timeline:
    """Verdicts in order of arrival, with the level of the battery at each."""

    def __init__(self, begin: float, track: Track) -> None:
        """Note nothing yet; times count from ``begin``, in seconds of the track's clock."""
        self._begin = begin
        self._track = track
        self._found: list[tuple[float, str, float]] = []

    @property
    def values(self) -> list[str]:
        """TRUE and FALSE, one for each run of equal verdicts."""
        known = [each for each in list(self._found) if each[1] != "UNKNOWN"]
        return [value for value, _ in groupby(known, itemgetter(1))]

    def note(self, arrival: float, value: str, level: float) -> bool:
        """Add a verdict; returns whether it differs from the one before."""
        is_other = not self._found or self._found[-1][1] != value
        self._found.append((arrival - self._begin, value, level))
        return is_other

    def draw(self, folder: Path, name: str) -> list[Path]:
        """Draw a picture as PNG and as SVG, into files of that name."""
        from matplotlib.figure import Figure  # takes a while

        figure = Figure(figsize=(8.0, 4.2))
        error, battery, verdict = figure.subplots(
            3, 1, sharex=True, gridspec_kw={"height_ratios": (4, 3, 1)}
        )
        points = [(arrival - self._begin, value) for arrival, value in self._track.errors]
        if points:
            error.plot(*zip(*points), ".", markersize=3, color="#3060a0")
        error.set(ylabel="error (m)", ylim=(0.0, None))
        error.set_title("A verdict decides which camera sees the ball", fontsize="medium")
        found = list(self._found)
        times = [when for when, _, _ in found]
        battery.plot(times, [100 * level for _, _, level in found], color="#606060")
        battery.axhline(20.0, linestyle="--", linewidth=0.8, color="#606060")
        battery.set(ylabel="battery (%)", ylim=(0.0, 60.0))
        runs = [list(run) for _, run in groupby(found, itemgetter(1))]
        ends = [run[0][0] for run in runs[1:]] + times[-1:]
        for run, end in zip(runs, ends):
            begin, value, _ = run[0]
            verdict.barh(0, end - begin, left=begin, color=_COLOURS[value])
            verdict.text((begin + end) / 2, 0, value, ha="center", va="center", fontsize="small")
        verdict.set(yticks=[], ylabel="charged", xlabel="time (s)")
        figure.align_ylabels()
        files = [folder / f"{name}.{form}" for form in ("png", "svg")]
        for file in files:
            figure.savefig(file, dpi=120, bbox_inches="tight")
        return files
