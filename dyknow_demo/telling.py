# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The lines and pictures of the story: the graph, how well the ball is tracked, and verdicts."""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import AbstractSet, Callable, Iterator

from dyknow import names
from dyknow.graphviz import quote, render
from dyknow.model.graph import Model, NodeletStatus, State
from dyknow.wiring.ports import topics_of
from dyknow_demo.soccer.geometry import Array

#: Metres: several times the measured error; a stream of wrong positions must not pass.
LARGE_ERROR = 0.3

_LAYOUT_TIMEOUT = 20.0  # s
_COLOURS = {"TRUE": "#8fcf8f", "FALSE": "#e09090", "UNKNOWN": "#cccccc"}
_KEPT, _NEW, _IDLE = "#cfe2f3", "#c6e7c8", "#eeeeee"
_HEAD = """digraph story {
  rankdir=TB; nodesep=0.2; ranksep=0.25; labelloc=t; fontname="sans-serif"; fontsize=15;
  node [fontname="sans-serif", fontsize=12, margin="0.08,0.04", height=0.3];
  edge [fontname="sans-serif", fontsize=10];"""


@dataclass(frozen=True)
class Stretch:
    """The positions that arrived in a stretch of time."""

    count: int  # number of positions
    rate: float  # positions per second
    median: float  # median error, m; nan without positions
    worst: float  # greatest error, m; nan without positions
    pause: float  # longest time (s) without a position, the time at either end included

    def shortcomings(self, max_silence: float) -> list[str]:
        """List how the promise of a claim with that ``max_silence`` (s) is broken."""
        found = []
        if self.pause > max_silence:
            found.append(f"the position was lost for {self.pause:.2f} s, not {max_silence:g} s")
        if not self.median < LARGE_ERROR:
            found.append(f"the positions are wrong by {self.median:.2f} m")
        return found


class Track:
    """Arrivals and errors, in order of arrival; arrival times are of one steady clock."""

    def __init__(self, begin: float, truth: Callable[[float], Array]) -> None:
        """Make an empty track; positions are expected from ``begin`` (s) on.

        ``truth`` returns the centre of the ball (3,), m, by time of the stamps, s.
        """
        self._begin = begin
        self._truth = truth
        self._found: list[tuple[float, float]] = []

    def note(self, arrival: float, stamp: float, x: float, y: float) -> None:
        """Add a position (m) on the field."""
        truth = self._truth(stamp)
        self._found.append((arrival, float(((x - truth[0]) ** 2 + (y - truth[1]) ** 2) ** 0.5)))

    @property
    def errors(self) -> list[tuple[float, float]]:
        """Times of arrival (s), each with the error (m)."""
        return list(self._found)

    def stretch(self, end: float, begin: float | None = None) -> Stretch:
        """Summarise the arrivals between two times, by default from the first one on."""
        begin = self._begin if begin is None else begin
        found = list(self._found)
        errors = [error for arrival, error in found if begin <= arrival <= end]
        times = [self._begin, *(arrival for arrival, _ in found if arrival <= end), end]
        return Stretch(
            len(errors),
            len(errors) / (end - begin) if end > begin else 0.0,
            statistics.median(errors) if errors else float("nan"),
            max(errors, default=float("nan")),
            max(later - earlier for earlier, later in zip(times, times[1:]) if later >= begin),
        )


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
        files = _pictures(folder, name)
        for file in files:
            figure.savefig(file, dpi=120, bbox_inches="tight")
        return files


def _pictures(folder: Path, name: str) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    return [folder / f"{name}.{form}" for form in ("png", "svg")]


def changes(before: Model, after: Model, space: str = "/") -> list[str]:
    """List nodelets that came, went or were re-wired, a line each, without a namespace.

    Out-ports that publish on the topic of their own name, as most do, are left out.
    """
    old, new = _running(before), _running(after)
    lines = [f"+ {_short(name, space)}" for name in sorted(new) if name not in old]
    for name in sorted(new):
        lines.extend(_wirings(old.get(name), new[name], space))
    return lines + [f"- {_short(name, space)}" for name in sorted(old) if name not in new]


def _short(name: str, space: str) -> str:
    prefix = names.join(space, "")
    return name[len(prefix) :] if name.startswith(prefix) else name


def _running(model: Model) -> dict[str, NodeletStatus]:
    return {each.name: each for each in model.nodelets if each.state is State.RUNNING}


def _wirings(old: NodeletStatus | None, new: NodeletStatus, space: str) -> Iterator[str]:
    for port in new.ports:
        before = old.port(port.name) if old is not None else None
        was = before.topic if before is not None else ""
        is_usual = port.direction == "out" and port.topic == names.join(new.name, port.name)
        if was == port.topic or is_usual:
            continue
        arrow = "<-" if port.direction == "in" else "->"
        topic = _short(port.topic, space) or "nothing"
        what = f"  {_short(new.name, space)}.{port.name} {arrow} {topic}"
        yield f"{what} (was {_short(was, space)})" if was else what


def to_dot(
    title: str, model: Model, first: Model, needed: AbstractSet[str], goal: str, space: str = "/"
) -> str:
    """Write a picture of the graph in graphviz's DOT language, with names below ``space``.

    Ovals are nodelets and rectangles are topics; the topic of the client, the goal, is drawn bold.
    Nodelets of the first picture are blue, new ones are green, and those that the stream no longer
    needs are grey. Nodelets that have gone since the first picture are dashed.
    """

    def label(name: str) -> str:
        head, slash, tail = _short(name, space).rpartition("/")
        return quote(*([head, slash + tail] if head else [slash + tail]))

    there, known = _running(model), _running(first)
    lines = [_HEAD, f"  label={quote(title)};"]
    for name in sorted({*there, *known}):
        fill = _IDLE if name not in needed else _KEPT if name in known else _NEW
        style = f'style=filled, fillcolor="{fill}"'
        if name not in there:
            style = "style=dashed, color=gray50, fontcolor=gray50"
        lines.append(f"  {quote('n' + name)} [label={label(name)}, {style}];")
    lines.append(f"  client [shape=plaintext]; {quote('t' + goal)} -> client;")
    for topic in topics_of(tuple(there.values())):
        node = quote("t" + topic.name)
        if topic.targets or topic.name == goal:
            bold = ", style=bold" if topic.name == goal else ""
            lines.append(f"  {node} [label={label(topic.name)}, shape=box{bold}];")
            lines += [f"  {quote('n' + each.nodelet)} -> {node};" for each in topic.sources]
            for each in topic.targets:
                lines.append(
                    f"  {node} -> {quote('n' + each.nodelet)} [label={quote(each.port)}];"
                )
    return "\n".join([*lines, "}"]) + "\n"


def draw(dot: str, folder: Path, name: str) -> list[Path]:
    """Draw a picture as PNG and as SVG, into files of that name; raises CannotDraw."""
    files = _pictures(folder, name)
    for file in files:
        file.write_bytes(render(dot, file.suffix[1:], _LAYOUT_TIMEOUT))
    return files
