# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark throughput``: messages per second through a chain, DyKnow beside rospy.

The chain is closed to a ring in which some messages go round as fast as they can, so that it is
neither starved nor flooded. rospy's chain runs within one process, as DyKnow's does.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import Dict, List

import rospy
from std_msgs.msg import Empty, Float64MultiArray

from dyknow.locks import state_condition
from dyknow_benchmark import machine, options, progress
from dyknow_benchmark.chains import load_hops
from dyknow_benchmark.control import LEAD, TAIL
from dyknow_benchmark.managers import RunningManager
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import START_PATIENCE, MeasurementFailed, Session
from dyknow_benchmark.summary import median
from dyknow_benchmark.targets import Verdict

HEADER = ("kind", "hops", "runs", "lost", "median_hz", "low_hz", "high_hz")
#: How many times rospy's messages per second DyKnow should reach.
FACTOR = 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--hops", type=options.positive, default=50)
    parser.add_argument(
        "--window",
        type=options.positive,
        default=10,
        help="messages that go round (default: %(default)d; queues hold 10)",
    )
    parser.add_argument("--seconds", type=float, default=2.0, help="of each run")
    parser.add_argument("--repeats", type=options.positive, default=5, help="runs of each kind")


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    rates: Dict[str, List[float]] = {"dyknow": [], "rospy": []}
    lost = dict.fromkeys(rates, 0)
    with Session() as session:
        rings = {kind: _build(session, kind, arguments.hops) for kind in rates}
        load = machine.Load()
        turns = [kind for _ in range(arguments.repeats) for kind in rates]
        for kind in progress.steps(turns, "throughput", len(turns), "run"):
            rounds, returned = rings[kind].turn(arguments.window, arguments.seconds)
            rates[kind].append(rounds / arguments.seconds)
            lost[kind] += arguments.window - int(returned)
    middle = {kind: median(values) for kind, values in rates.items()}
    if not middle["rospy"]:
        raise MeasurementFailed("no message came round in rospy's chain")
    results = Results(
        load.rows(),
        [
            Verdict(
                f"messages per second of DyKnow / of rospy in one process, {arguments.hops} hops",
                middle["dyknow"] / middle["rospy"],
                FACTOR,
                at_least=True,
            )
        ],
    )
    rows = [
        (kind, arguments.hops, len(values), lost[kind], middle[kind], min(values), max(values))
        for kind, values in rates.items()
    ]
    results.table("throughput", "messages per second", HEADER, rows)
    return results


class RingControl:
    """The control topics of one ring."""

    def __init__(self, control: str) -> None:
        """Connect to a ring."""
        self._changed = state_condition("throughput")
        self._report: List[float] = []
        self._send = rospy.Publisher(control + "/send", Float64MultiArray, queue_size=10)
        self._collect = rospy.Publisher(control + "/collect", Empty, queue_size=10)
        rospy.Subscriber(control + "/report", Float64MultiArray, self._on_report)

    def settle(self, session: Session) -> None:
        """Return once a message goes all the way round."""
        end = time.monotonic() + START_PATIENCE
        while time.monotonic() < end:
            session.check()
            if self.turn(1, 0.2)[1] == 1:
                return
        raise MeasurementFailed(f"no message came round within {START_PATIENCE:g} s")

    def turn(self, window: int, seconds: float) -> List[float]:
        """Let messages go round; returns their rounds, and how many returned in the end."""
        self._send.publish(Float64MultiArray(data=[window, seconds, time.time() + LEAD]))
        time.sleep(LEAD + seconds)
        end = time.monotonic() + TAIL
        report = [0.0, 0.0]
        while report[1] < window and time.monotonic() < end:
            report = self._collected() or report
        return report

    def _collected(self) -> List[float]:
        with self._changed:
            self._report = []
            self._collect.publish(Empty())
            self._changed.wait_for(lambda: bool(self._report), 0.1)
            return self._report

    def _on_report(self, report: Float64MultiArray) -> None:
        with self._changed:
            self._report = list(report.data)
            self._changed.notify_all()


def _build(session: Session, kind: str, length: int) -> RingControl:
    control = f"/benchmark/ring_{kind}"
    if kind == "dyknow":
        manager = RunningManager.python(session)
        load_hops(manager, "", control, length)
        manager.load(
            f"{control}/ring",
            "dyknow_benchmark/ChainRing",
            {f"{control}/in": f"{control}/hop_{length}", f"{control}/out": f"{control}/hop_0"},
            {"control": control},
        )
    else:
        module = "dyknow_benchmark.process"
        where = ["--control", control, "--length", str(length)]
        session.start([sys.executable, "-m", module, "ring", *where])
    ring = RingControl(control)
    ring.settle(session)
    return ring
