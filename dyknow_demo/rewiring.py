# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The chain that is re-wired by hand: ``demo --rewiring``.

The chain is re-wired from outside, by ``set_config``. A camera is exchanged at the in-port of the
first stage. A stage is taken out, and put back, at the *out-port* before it: then frames that are
still inside the stage go on to the end. Moving the in-port behind it instead would leave them
behind, and on the way back deliver them a second time.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import time
from pathlib import Path
from typing import Any, Callable, Mapping, NamedTuple, Sequence

from nodelet.srv import NodeletLoad
from std_srvs.srv import Trigger

from dyknow import names
from dyknow.errors import DyKnowError, PeerTimeout
from dyknow.ros.client import ManagerClient
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient
from dyknow_demo.accounting import Account, Arrival, FrameName, Published, Switch, account, gaps
from dyknow_demo.images import SHARED_FRAMES, image_files
from dyknow_demo.processes import (
    MANAGER,
    NAMESPACE,
    Processes,
    check_real_time,
    find_master,
    forget_parameters,
    start_nodelet_manager,
)

_CAMERAS = ("camera_1", "camera_2")
_CHAIN = ("colour", "subsample", "reporter")
_TURN = 0.2  # s that each camera has when they take turns
_LOOK = 0.1  # s
_SETTLE = 3.0  # s for frames on their way
_CALL_TIMEOUT = 10.0  # s
_HEAD = (
    f"{'wiring':44}{'image':>9}{'frames':>8}{'Hz':>7}{'mean ms':>9}{'p99 ms':>8}"
    f"{'lost':>6}{'doubled':>9}{'re-wired in':>13}"
)


class Step(NamedTuple):
    """One wiring of the chain, its camera, and the change that leads to it.

    Attributes:
        wiring: the chain, as it is printed.
        camera: the camera that it begins with.
        change: nodelet, port and topic.
        turns: whether the cameras take turns from then on.
    """

    wiring: str
    camera: str
    change: tuple[str, str, str]
    turns: bool = False


_FULL = "camera_{} > colour > subsample > reporter"
STEPS = (
    Step(_FULL.format(1), "camera_1", ("colour", "image", "image_1")),
    Step(_FULL.format(2), "camera_2", ("colour", "image", "image_2")),
    Step("camera_2 > colour > reporter", "camera_2", ("colour", "converted", "small_image")),
    Step(_FULL.format(2), "camera_2", ("colour", "converted", "yuv_image")),
    Step(_FULL.format(1), "camera_1", ("colour", "image", "image_1")),
    Step(
        "camera_1 or 2, in turns of 0.2 s, > ...", "camera_2", ("colour", "image", "image_2"), True
    ),
)


def play(options: argparse.Namespace) -> bool:
    """Re-wire the chain; True if no frame was lost, doubled or out of order.

    Args:
        options: ``frames`` (folder or None), ``rendered``, ``seconds`` for each wiring, and
            ``rate`` of each camera in Hz.

    Raises:
        DyKnowError: something failed.
    """
    sources, text = _frames(options.frames, options.rendered)
    _tell(f"frames: {text}, {options.rate:g} Hz from each of two cameras")
    with Processes() as processes:
        _tell(f"ROS master: {find_master(processes)}")
        if _is_up():
            raise DyKnowError(
                f"{MANAGER} is registered at this master already: another demonstration runs "
                "there, or was killed ('rosnode cleanup' forgets it)"
            )
        check_real_time()
        pid = start_nodelet_manager(processes, _is_up)
        _tell(f"nodelet manager: {MANAGER}, process {pid}\n")
        try:
            return _Story(processes.check, sources, options.rate, options.seconds).run()
        except DyKnowError:
            processes.check(patience=0.5)  # a process that ended is the better explanation
            raise
        finally:
            forget_parameters()


def _frames(folder: Path | None, is_rendered: bool) -> tuple[list[list[str]], str]:
    """Deal the image files out to two cameras, and say where they come from."""
    given, folder = folder, folder or (SHARED_FRAMES if SHARED_FRAMES.is_dir() else None)
    if folder is None or is_rendered:
        return [[], []], "rendered, a ball on a field"
    files = [str(file.resolve()) for file in image_files(folder)]
    if given and not files:
        raise DyKnowError(f"no JPEG or PNG files in '{folder}'")
    return [files[0::2], files[1::2] or files], f"{len(files)} real ones from {folder}"


def _is_up() -> bool:
    with contextlib.suppress(LookupError, PeerTimeout):
        return bool(Master(NAMESPACE).ask("lookupService", f"{MANAGER}/load_nodelet"))
    return False


def _tell(text: str) -> None:
    """Print a line for good, over the line of progress."""
    print(("\r\033[K" if sys.stdout.isatty() else "") + text, flush=True)


def _full(name: str) -> str:
    return names.join(NAMESPACE, name)


class _Story:
    """Runs the chain through all its wirings and accounts for the frames of each."""

    def __init__(
        self,
        check: Callable[[], None],
        sources: Sequence[Sequence[str]],
        rate: float,
        seconds: float,
    ) -> None:
        """Prepare; ``check`` raises when a process has ended, sources are files of each camera."""
        self._check, self._sources, self._rate, self._seconds = check, sources, rate, seconds
        self._master, self._client = Master(_full("dyknow_demo")), ManagerClient()
        self._switches: list[Switch] = []

    def run(self) -> bool:
        self._load()
        _tell(f"{_HEAD}\n{'-' * len(_HEAD)}")
        for number, step in enumerate(STEPS):
            self._switch(str(number), step.camera, step.change)
            if number:
                self._row(number - 1)
            self._watch(number, step)
        self._switch("end", "", ("colour", "image", ""))
        self._row(len(STEPS) - 1)
        return self._verdict()

    def _load(self) -> None:
        self._load_nodelet("reporter", "Reporter", {"image": "small_image"})
        ports = {"image": "yuv_image", "subsampled": "small_image"}
        self._load_nodelet("subsample", "Subsample", ports, factor=2)
        self._load_nodelet("colour", "ColorConvert", {"converted": "yuv_image"}, encoding="yuv")
        for number, (camera, files) in enumerate(zip(_CAMERAS, self._sources), start=1):
            topic = {"image": f"image_{number}"}
            self._load_nodelet(_witness(camera), "Reporter", topic)
            self._load_nodelet(camera, "Camera", topic, frames=files, rate=self._rate)

    def _load_nodelet(
        self, name: str, class_name: str, ports: Mapping[str, str], **parameters: Any
    ) -> None:
        for key, value in parameters.items():
            self._master.ask("setParam", names.join(_full(name), key), value)
        ServiceClient(self._master, f"{MANAGER}/load_nodelet", NodeletLoad).call(
            _CALL_TIMEOUT,
            name=_full(name),
            type=f"dyknow_demo/{class_name}",
            remap_source_args=[_full(port) for port in ports],
            remap_target_args=[_full(topic) for topic in ports.values()],
        )

    def _connect(self, name: str, port: str, topic: str) -> None:
        self._client.set_config(_full(name), {port: topic and _full(topic)})

    def _switch(self, stage: str, camera: str, change: tuple[str, str, str]) -> None:
        called = time.time()
        self._connect(*change)
        self._switches.append(Switch(camera, stage, called, time.time()))

    def _watch(self, number: int, step: Step) -> None:
        begin, camera = time.monotonic(), step.camera
        while (passed := time.monotonic() - begin) < self._seconds:
            self._check()
            if sys.stdout.isatty():
                text = f"{step.wiring}: {passed:.1f} of {self._seconds:g} s"
                print(f"\r\033[K{text}", end="", flush=True)
            time.sleep(_TURN if step.turns else _LOOK)
            if step.turns:
                camera = _CAMERAS[1 - _CAMERAS.index(camera)]
                topic = f"image_{_CAMERAS.index(camera) + 1}"
                self._switch(str(number), camera, ("colour", "image", topic))

    def _row(self, number: int) -> None:
        """Print the account of one wiring, and how long the calls took."""
        found = self._settled()[str(number)]
        times = [
            1000 * (switch.returned - switch.called)
            for switch in self._switches
            if switch.stage == str(number)
        ]
        took = f"{sum(times) / len(times):.1f} ms"
        if len(times) > 1:
            took = f"{len(times)}x {took}"
        size = "{}x{}".format(*found.size)
        _tell(
            f"{STEPS[number].wiring:44}{size:>9}{found.messages:8}{found.rate:7.1f}"
            f"{1000 * found.mean:9.2f}{1000 * found.percentile(99):8.2f}"
            f"{found.lost:6}{found.doubled:9}{took:>13}"
        )

    def _settled(self) -> dict[str, Account]:
        """Wait for frames on their way, but not for lost ones, and settle the accounts."""
        deadline = time.monotonic() + _SETTLE
        while True:
            # In this order, so that nothing has arrived that the witnesses have not seen.
            arrivals = [
                Arrival(FrameName.parse(name), sent, arrived, (width, height))
                for name, sent, arrived, width, height in self._arrivals("reporter")
            ]
            accounts = account(self._published(), arrivals, self._switches)
            if not any(each.lost for each in accounts.values()) or time.monotonic() > deadline:
                return accounts
            time.sleep(_LOOK)

    def _published(self) -> list[Published]:
        return [
            Published(FrameName.parse(name), sent, seen)
            for camera in _CAMERAS
            for name, sent, seen, _, _ in self._arrivals(_witness(camera))
        ]

    def _arrivals(self, reporter: str) -> list[Any]:
        """Records of a reporter; see ``dyknow_demo.nodelets.Reporter``."""
        service = names.join(_full(reporter), "arrivals")
        records = json.loads(
            ServiceClient(self._master, service, Trigger).call(_CALL_TIMEOUT).message
        )
        assert isinstance(records, list)
        return records

    def _verdict(self) -> bool:
        for camera in _CAMERAS:
            self._connect(camera, "image", "")
        accounts = self._settled().values()
        problems = self._disagreements()
        lost, doubled, reordered, frames = (
            sum(getattr(each, name) for each in accounts)
            for name in ("lost", "doubled", "reordered", "messages")
        )
        _tell(
            f"\n{len(self._switches)} re-wirings while it ran, {frames} frames at the end of the "
            f"chain: {lost} lost, {doubled} doubled, {reordered} out of order."
        )
        for problem in problems:
            _tell(f"The account cannot be trusted: {problem}.")
        return not (lost or doubled or reordered or problems)

    def _disagreements(self) -> list[str]:
        """Compare the counts of cameras, proxies and witnesses."""
        problems = []
        for camera in _CAMERAS:
            sent, seen = self._messages(camera), self._messages(_witness(camera))
            deadline = time.monotonic() + _SETTLE
            while seen != sent and time.monotonic() < deadline:
                time.sleep(_LOOK)
                seen = self._messages(_witness(camera))
            recorded = len(self._arrivals(_witness(camera)))
            _tell(f"{camera} published {sent} frames, its witness saw {seen}.")
            if not sent == seen == recorded:
                problems.append(f"{camera} published {sent} frames, {recorded} are recorded")
        missed = gaps(self._published())
        if missed:
            problems.append(f"the witnesses missed {missed} frames")
        for name in (*_CHAIN, *_CAMERAS, *map(_witness, _CAMERAS)):
            errors = self._client.get_statistics(_full(name)).callback_errors
            if errors:
                problems.append(f"{errors} callbacks of {name} failed")
        return problems

    def _messages(self, name: str) -> int:
        """Messages at the port ``image`` of a nodelet, as its proxy counts them."""
        ports = self._client.get_statistics(_full(name)).ports
        return sum(each.messages or 0 for each in ports if each.port == "image")


def _witness(camera: str) -> str:
    return camera.replace("camera", "witness")
