# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The story: a chain of nodelets that is re-wired in several ways while it runs.

The chain is re-wired from outside, by ``set_config``. A camera is exchanged at the in-port of the
first stage. A stage is taken out, and put back, at the *out-port* before it: then what is still
inside the stage goes on to the end. Moving the in-port behind it instead would leave that behind,
and on the way back deliver it a second time.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, List, Sequence, Tuple

from dyknow_demo.rewiring.accounting import Account, Arrival, Published, Switch, account, gaps
from dyknow_demo.rewiring.frame_names import FrameName
from dyknow_demo.rewiring.graph import HandWiredGraph
from dyknow_demo.rewiring.table import ReportTable

_CAMERAS = ("camera_1", "camera_2")
_CHAIN = ("colour", "subsample", "reporter")
_TURN = 0.2  # s that each camera has when they take turns
_LOOK = 0.1  # s
_SETTLE = 3.0  # s for frames on their way


@dataclass(frozen=True)
class Step:
    """One wiring of the chain and the change that leads to it.

    Attributes:
        wiring: the chain, for people.
        camera: the camera that it begins with.
        change: nodelet, port and topic.
        turns: whether the cameras take turns from then on.
    """

    wiring: str
    camera: str
    change: Tuple[str, str, str]
    turns: bool = False


STEPS = (
    Step("camera_1 > colour > subsample > reporter", "camera_1", ("colour", "image", "image_1")),
    Step("camera_2 > colour > subsample > reporter", "camera_2", ("colour", "image", "image_2")),
    Step("camera_2 > colour > reporter", "camera_2", ("colour", "converted", "small_image")),
    Step(
        "camera_2 > colour > subsample > reporter",
        "camera_2",
        ("colour", "converted", "yuv_image"),
    ),
    Step("camera_1 > colour > subsample > reporter", "camera_1", ("colour", "image", "image_1")),
    Step(
        "camera_1 or 2, in turns of 0.2 s, > ...",
        "camera_2",
        ("colour", "image", "image_2"),
        turns=True,
    ),
)


class Story:
    """Runs the chain through all its wirings and accounts for the frames of each."""

    def __init__(
        self,
        graph: HandWiredGraph,
        table: ReportTable,
        check: Callable[[], None],
        sources: Sequence[Sequence[Path]],
        rate: float,
        seconds: float,
    ) -> None:
        """Prepare the story.

        Args:
            graph: the nodelets.
            table: where to print.
            check: raises when a process has ended.
            sources: image files for each camera; none for rendered frames.
            rate: frames a second of each camera.
            seconds: time for each wiring.
        """
        self._graph = graph
        self._table = table
        self._check = check
        self._sources = sources
        self._rate = rate
        self._seconds = seconds
        self._switches: List[Switch] = []

    def run(self) -> bool:
        """Show everything; True if no frame was lost, doubled or overtaken by a later one."""
        self._load()
        self._table.head()
        for number, step in enumerate(STEPS):
            self._switch(str(number), step.camera, step.change)
            if number:
                self._row(number - 1)
            self._watch(number, step)
        self._switch("end", "", ("colour", "image", ""))
        self._row(len(STEPS) - 1)
        return self._verdict()

    def _load(self) -> None:
        load = self._graph.load
        load("reporter", "dyknow_demo/Reporter", {"image": "small_image"}, {})
        load(
            "subsample",
            "dyknow_demo/Subsample",
            {"image": "yuv_image", "subsampled": "small_image"},
            {"factor": 2},
        )
        load("colour", "dyknow_demo/ColorConvert", {"converted": "yuv_image"}, {"encoding": "yuv"})
        for number, (camera, files) in enumerate(zip(_CAMERAS, self._sources), start=1):
            topic = {"image": f"image_{number}"}
            frames = [str(file) for file in files]
            load(_witness(camera), "dyknow_demo/Reporter", topic, {})
            load(camera, "dyknow_demo/Camera", topic, {"frames": frames, "rate": self._rate})

    def _switch(self, stage: str, camera: str, change: Tuple[str, str, str]) -> None:
        called, returned = self._graph.connect(*change)
        self._switches.append(Switch(camera, stage, called, returned))

    def _watch(self, number: int, step: Step) -> None:
        begin = time.monotonic()
        camera = step.camera
        while time.monotonic() - begin < self._seconds:
            self._check()
            passed = time.monotonic() - begin
            self._table.progress(f"{step.wiring}: {passed:.1f} of {self._seconds:g} s")
            time.sleep(_TURN if step.turns else _LOOK)
            if step.turns:
                camera = _CAMERAS[1 - _CAMERAS.index(camera)]
                topic = f"image_{_CAMERAS.index(camera) + 1}"
                self._switch(str(number), camera, ("colour", "image", topic))

    def _row(self, number: int) -> None:
        accounts = self._settled()
        times = [
            1000 * (switch.returned - switch.called)
            for switch in self._switches
            if switch.stage == str(number)
        ]
        took = f"{sum(times) / len(times):.1f} ms"
        if len(times) > 1:
            took = f"{len(times)}x {took}"
        self._table.row(STEPS[number].wiring, accounts[str(number)], took)

    def _settled(self) -> Dict[str, Account]:
        """Wait for frames on their way, but not for lost ones, and settle the accounts."""
        deadline = time.monotonic() + _SETTLE
        while True:
            # In this order, so that nothing has arrived that the witnesses have not seen.
            arrivals = [_arrival(record) for record in self._graph.arrivals("reporter")]
            accounts = account(self._published(), arrivals, self._switches)
            if not any(each.lost for each in accounts.values()) or time.monotonic() > deadline:
                return accounts
            time.sleep(_LOOK)

    def _published(self) -> List[Published]:
        records = [
            record for camera in _CAMERAS for record in self._graph.arrivals(_witness(camera))
        ]
        return [Published(FrameName.parse(name), sent, seen) for name, sent, seen, _, _ in records]

    def _verdict(self) -> bool:
        table = self._table
        for camera in _CAMERAS:
            self._graph.connect(camera, "image", "")
        accounts = self._settled().values()
        problems = self._disagreements()
        lost, doubled, reordered, frames = (
            sum(getattr(each, name) for each in accounts)
            for name in ("lost", "doubled", "reordered", "messages")
        )
        table.line()
        table.line(
            f"{len(self._switches)} re-wirings while it ran, {frames} frames at the end of the "
            f"chain: {lost} lost, {doubled} doubled, {reordered} out of order."
        )
        for problem in problems:
            table.line(f"The account cannot be trusted: {problem}.")
        return not (lost or doubled or reordered or problems)

    def _disagreements(self) -> List[str]:
        """Compare what cameras, proxies and witnesses counted, each by itself."""
        problems = []
        for camera in _CAMERAS:
            sent, seen, recorded = self._counts(camera)
            self._table.line(f"{camera} published {sent} frames, its witness saw {seen}.")
            if not sent == seen == recorded:
                problems.append(f"{camera} published {sent} frames, {recorded} are recorded")
        missed = gaps(self._published())
        if missed:
            problems.append(f"the witnesses missed {missed} frames")
        for name in (*_CHAIN, *_CAMERAS, *map(_witness, _CAMERAS)):
            errors = self._graph.statistics(name)[1]
            if errors:
                problems.append(f"{errors} callbacks of {name} failed")
        return problems

    def _counts(self, camera: str) -> Tuple[int, int, int]:
        """Count by the proxy of the camera, by that of its witness, and by the witness itself."""
        sent = self._graph.statistics(camera)[0]["image"].messages or 0
        deadline = time.monotonic() + _SETTLE
        while True:
            seen = self._graph.statistics(_witness(camera))[0]["image"].messages or 0
            if seen == sent or time.monotonic() > deadline:
                return sent, seen, len(self._graph.arrivals(_witness(camera)))
            time.sleep(_LOOK)


def _witness(camera: str) -> str:
    return camera.replace("camera", "witness")


def _arrival(record: Sequence[Any]) -> Arrival:
    name, sent, arrived, width, height = record
    return Arrival(FrameName.parse(name), sent, arrived, (width, height))
