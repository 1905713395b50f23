# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A robot's vision that is re-wired by hand: ``demo --rewiring``.

The chain is re-wired from outside, by ``set_config``. A camera is exchanged at the in-port of the
first stage. A stage is taken out, and put back, at the *out-port* before it: then frames that are
still inside the stage go on to the end. Moving the in-port behind it instead would leave them
behind, and on the way back deliver them a second time.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import sys
import time
from typing import Any, Callable, Mapping, NamedTuple

from nodelet.srv import NodeletLoad
from std_srvs.srv import Trigger

from dyknow import names
from dyknow.errors import PeerTimeout
from dyknow.ros.client import ManagerClient
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient
from dyknow_demo.accounting import Account, FrameRecord, Switch, account
from dyknow_demo.processes import MANAGER, NAMESPACE, own_processes, running, tell

_SECONDS = 6.0
_CAMERAS = ("camera_1", "camera_2")
_WITNESSES = {"camera_1": "witness_1", "camera_2": "witness_2"}
_TURN = 0.2  # s that each camera has when they take turns
_LOOK = 0.1  # s
_SETTLE = 3.0  # s for frames on their way
_CALL_TIMEOUT = 10.0  # s
_HEAD = (
    f"{'wiring':44}{'image':>9}{'frames':>8}{'Hz':>7}{'mean ms':>9}{'p99 ms':>8}"
    f"{'lost':>6}{'doubled':>9}{'re-wired in':>13}"
)


class Step(NamedTuple):
    """One wiring of the chain, and the change that leads to it: a port of the relay.

    ``turns`` says whether the cameras take turns from then on.
    """

    wiring: str
    camera: str
    port: str
    topic: str
    turns: bool = False


_FULL = "camera_{} > relay > subsampler > reporter"
STEPS = (
    Step(_FULL.format(1), "camera_1", "in", "image_1"),
    Step(_FULL.format(2), "camera_2", "in", "image_2"),
    Step("camera_2 > relay > reporter", "camera_2", "out", "small_image"),
    Step(_FULL.format(2), "camera_2", "out", "yuv_image"),
    Step(_FULL.format(1), "camera_1", "in", "image_1"),
    Step("camera_1 or 2, in turns of 0.2 s, > ...", "camera_2", "in", "image_2", True),
)
#: Nodelets in the order of their load: type, topics by port, and parameters.
_NODELETS: dict[str, tuple[str, Mapping[str, str], Mapping[str, Any]]] = {
    "reporter": ("dyknow_demo/Reporter", {"image": "small_image"}, {}),
    "subsampler": (
        "dyknow_demo/ImageSubsampler",
        {"yuv": "yuv_image", "yuv_half": "small_image"},
        {},
    ),
    "relay": ("dyknow/Relay", {"out": "yuv_image"}, {"datatype": "sensor_msgs/Image"}),
    "witness_1": ("dyknow_demo/Reporter", {"image": "image_1"}, {}),
    "witness_2": ("dyknow_demo/Reporter", {"image": "image_2"}, {}),
    "camera_1": ("dyknow_demo/BottomCamera", {"image": "image_1"}, {"seed": 1}),
    "camera_2": ("dyknow_demo/BottomCamera", {"image": "image_2"}, {"seed": 2}),
}


def play(options: argparse.Namespace) -> bool:
    """Re-wire the chain; True if no frame was lost, doubled or out of order.

    Args:
        options: ``seconds`` for each wiring, and ``rate`` of each camera in Hz.

    Raises:
        DyKnowError: something failed.
    """
    tell(f"{options.rate:g} frames a second from each of two cameras")
    with own_processes() as processes, running(
        processes, "nodelet manager", _is_up, "dyknow.cli.nodelet", "manager"
    ):
        return _Story(processes.check, options.rate, options.seconds or _SECONDS).run()


def _is_up() -> bool:
    with contextlib.suppress(LookupError, PeerTimeout):
        return bool(Master(NAMESPACE).ask("lookupService", f"{MANAGER}/load_nodelet"))
    return False


def _full(name: str) -> str:
    return names.join(NAMESPACE, name)


class _Story:
    """Runs the chain through all its wirings and accounts for the frames of each."""

    def __init__(self, check: Callable[[], None], rate: float, seconds: float) -> None:
        """Prepare; ``check`` raises when a process has ended."""
        self._check, self._rate, self._seconds = check, rate, seconds
        self._master, self._client = Master(_full("dyknow_demo")), ManagerClient()
        self._switches: list[Switch] = []

    def run(self) -> bool:
        for name in _NODELETS:
            self._load(name)
        tell(f"{_HEAD}\n{'-' * len(_HEAD)}")
        for number, step in enumerate(STEPS):
            self._switch(str(number), step.camera, step.port, step.topic)
            if number:
                self._row(number - 1)
            self._watch(number, step)
        self._switch("end", "", "in", "")
        self._row(len(STEPS) - 1)
        return self._verdict()

    def _load(self, name: str) -> None:
        type_name, ports, parameters = _NODELETS[name]
        if name in _CAMERAS:
            parameters = {**parameters, "rate": self._rate}
        for key, value in parameters.items():
            self._master.ask("setParam", names.join(_full(name), key), value)
        ServiceClient(self._master, f"{MANAGER}/load_nodelet", NodeletLoad).call(
            _CALL_TIMEOUT,
            name=_full(name),
            type=type_name,
            remap_source_args=[_full(port) for port in ports],
            remap_target_args=[_full(topic) for topic in ports.values()],
        )

    def _switch(self, stage: str, camera: str, port: str, topic: str) -> None:
        called = time.time()
        self._client.set_config(_full("relay"), {port: topic and _full(topic)})
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
                index = 1 - _CAMERAS.index(camera)
                camera = _CAMERAS[index]
                self._switch(str(number), camera, "in", f"image_{index + 1}")

    def _row(self, number: int) -> None:
        found = self._settled()[str(number)]
        times = [
            1000 * (each.returned - each.called)
            for each in self._switches
            if each.stage == str(number)
        ]
        took = f"{sum(times) / len(times):.1f} ms"
        took = f"{len(times)}x {took}" if len(times) > 1 else took
        size = "{}x{}".format(*(found.arrivals[-1][-2:] if found.arrivals else (0, 0)))
        latencies = found.latencies
        mean = 1000 * sum(latencies) / len(latencies)
        p99 = 1000 * latencies[math.ceil(0.99 * len(latencies)) - 1]
        tell(
            f"{STEPS[number].wiring:44}{size:>9}{len(found.arrivals):8}{found.rate:7.1f}"
            f"{mean:9.2f}{p99:8.2f}{found.lost:6}{found.doubled:9}{took:>13}"
        )

    def _settled(self) -> dict[str, Account]:
        """Wait for frames on their way, but not for lost ones, and settle the accounts."""
        deadline = time.monotonic() + _SETTLE
        while True:
            # In this order, so that nothing has arrived that the witnesses have not seen.
            arrivals = self._arrivals("reporter")
            published = [each for name in _WITNESSES.values() for each in self._arrivals(name)]
            accounts = account(published, arrivals, self._switches)
            if not any(each.lost for each in accounts.values()) or time.monotonic() > deadline:
                return accounts
            time.sleep(_LOOK)

    def _arrivals(self, name: str) -> list[FrameRecord]:
        service = ServiceClient(self._master, _full(f"{name}/arrivals"), Trigger)
        return [FrameRecord(*each) for each in json.loads(service.call(_CALL_TIMEOUT).message)]

    def _verdict(self) -> bool:
        accounts = self._settled().values()
        count = sum(len(each.arrivals) for each in accounts)
        lost, doubled, reordered = (
            sum(getattr(each, what) for each in accounts)
            for what in ("lost", "doubled", "reordered")
        )
        problems = self._problems()
        tell(
            f"\n{count} frames at the end of the chain: "
            f"{lost} lost, {doubled} doubled, {reordered} out of order."
        )
        for problem in problems:
            tell(f"The account cannot be trusted: {problem}.")
        return not (lost or doubled or reordered or problems)

    def _problems(self) -> list[str]:
        """Compare what cameras published with what their witnesses recorded."""
        problems = []
        for camera, witness in _WITNESSES.items():
            ports = self._client.get_statistics(_full(camera)).ports
            sent = sum(each.messages or 0 for each in ports if each.port == "image")
            deadline = time.monotonic() + _SETTLE
            while (seen := len(self._arrivals(witness))) < sent and time.monotonic() < deadline:
                time.sleep(_LOOK)
            if seen < sent:
                problems.append(f"{camera} published {sent} frames, {seen} are recorded")
        for name in _NODELETS:
            errors = self._client.get_statistics(_full(name)).callback_errors
            if errors:
                problems.append(f"{errors} callbacks of {name} failed")
        return problems
