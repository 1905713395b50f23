# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark idle``: CPU time of a nodelet manager whose nodelets have nothing to do."""

from __future__ import annotations

import argparse
import time

from dyknow_benchmark import machine, options, progress
from dyknow_benchmark.chains import load_hops
from dyknow_benchmark.managers import RunningManager
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import Session

HEADER = ("nodelets", "seconds", "cpu_seconds", "cpu_percent")
#: Seconds for the manager to come to rest after the last load.
_REST = 2.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--nodelets", type=options.positive, default=50)
    parser.add_argument("--seconds", type=float, default=30.0)


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    with Session() as session:
        manager = RunningManager.python(session)
        load_hops(manager, "", "/benchmark/idle", arguments.nodelets)
        time.sleep(_REST)
        load = machine.Load()
        progress.say(f"watching {arguments.nodelets} nodelets for {arguments.seconds:g} s")
        begin, used = time.monotonic(), machine.cpu_seconds(manager.pid)
        time.sleep(arguments.seconds)
        seconds, used = time.monotonic() - begin, machine.cpu_seconds(manager.pid) - used
    results = Results(load.rows())
    row = (arguments.nodelets, seconds, used, 100.0 * used / seconds)
    results.table("idle", "an idle nodelet manager", HEADER, [row])
    return results
