# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark recover``: time from kill -9 of the nodelet manager until every stream is back.

Each kill follows as soon as the streams are back from the last, so the times include the pauses
before a nodelet manager that dies repeatedly is restarted.
"""

from __future__ import annotations

import argparse
import os
import signal
import time
from typing import Dict, List

import rospy
from std_msgs.msg import Header

from dyknow.locks import state_lock
from dyknow_benchmark import machine, options, progress, system
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import Session, wait_until
from dyknow_benchmark.targets import Verdict

HEADER = ("nodelets", "kills", "min_s", "median_s", "max_s")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--nodelets", type=options.positive, default=20)
    parser.add_argument("--kills", type=options.positive, default=5)


class _Streams:
    """When a message of each stream was last heard, in this process."""

    def __init__(self, topics: List[str]) -> None:
        self._lock = state_lock("deliveries")
        self._last: Dict[str, float] = dict.fromkeys(topics, 0.0)
        self._subscribers = [
            rospy.Subscriber(topic, Header, self._hear, callback_args=topic) for topic in topics
        ]

    def _hear(self, message: Header, topic: str) -> None:
        with self._lock:
            self._last[topic] = time.monotonic()

    def all_since(self, moment: float) -> bool:
        """Whether every stream was heard after ``moment``."""
        with self._lock:
            return all(last > moment for last in self._last.values())


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    times: List[float] = []
    with Session() as session:
        client = system.start(session)
        client.spawn("source", "/source", {"out": "/t0"})
        for number in range(arguments.nodelets - 1):
            client.spawn("relay", f"/n{number}", {"in": f"/t{number}", "out": f"/t{number + 1}"})
        streams = _Streams([f"/t{number}" for number in range(arguments.nodelets)])
        wait_until(lambda: streams.all_since(0.1), "every stream to flow")
        load = machine.Load()
        for number in range(arguments.kills):
            pid = system.pid(system.NODELET_MANAGER)
            progress.say(f"kill -9 of process {pid}, {number + 1} of {arguments.kills}")
            killed = time.monotonic()
            os.kill(pid, signal.SIGKILL)
            # Messages that are still in sockets are not of the new nodelets.
            wait_until(lambda killed=killed: streams.all_since(killed + 0.3), "the streams")  # type: ignore[misc]
            times.append(time.monotonic() - killed)
            progress.say(f"all streams back after {times[-1]:.2f} s")
    row = (arguments.nodelets, arguments.kills, *system.spread(times))
    results = Results(load.rows(), [Verdict("all streams back, longest in s", max(times), 3.0)])
    results.table("recover", "recovery of a killed nodelet manager", HEADER, [row])
    return results
