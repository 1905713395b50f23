# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark scripts``: unchanged scripts of rospy in one nodelet manager, and as processes.

The same two nodes, a source and a receiver, pass images. As processes they do it over TCP; as
scripts in one nodelet manager they get structural copies. Their messages alternate with those of
two nodelets that are written for DyKnow, which share the images. Then scripts are loaded, for the
time that a load takes and for the memory that each needs.
"""

from __future__ import annotations

import argparse
import time
from typing import List, Sequence, Tuple

from dyknow_benchmark import machine, options, progress, tables
from dyknow_benchmark.chains import Chains
from dyknow_benchmark.control import Order, run_alternating
from dyknow_benchmark.footprint import held
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import Session
from dyknow_benchmark.summary import ARRIVALS, Summary, median
from dyknow_benchmark.targets import Verdict

HEADER = ("kind", *ARRIVALS)
LOADS = ("scripts", "median_load_ms", "p99_load_ms", "max_load_ms", "kib_each", "threads_each")
#: About a megabyte.
_IMAGE = "720x480"
_KINDS = ("script", "node", "dyknow")
#: Scripts that are loaded first: they load what all share.
_BEFORE = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--size", type=options.size, default=_IMAGE, help="default: %(default)s")
    parser.add_argument("--rate", type=options.rate, default=20.0, help="default: %(default)g")
    parser.add_argument(
        "--messages", type=options.positive, default=500, help="of each (default: %(default)d)"
    )
    parser.add_argument(
        "--scripts", type=options.positive, default=50, help="to load (default: %(default)d)"
    )


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    size, count = arguments.size, arguments.scripts
    with Session() as session:
        chains = Chains(session)
        progress.say(f"setting up a source and a receiver of {size}: {', '.join(_KINDS)}")
        controls = [chains.build(kind, 1, [1], size) for kind in _KINDS]
        load = machine.Load()
        turns, order = Order.in_turns(arguments.messages, arguments.rate)
        arrivals: List[List[float]] = [[] for _ in _KINDS]
        sent = 0
        for _ in progress.steps(range(turns), "images", turns):
            for found, block in zip(arrivals, run_alternating(controls, order)):
                found += block.latencies[1]
            sent += order.count
        progress.say(f"loading {count} scripts")
        took, loads = _load(chains, count)
    of = dict(zip(_KINDS, arrivals))
    verdicts = [
        Verdict(
            f"median of {size} between two scripts / between two rospy processes",
            median(of["script"]) / median(of["node"]),
            0.2,
        ),
        Verdict("load of a script, median in ms", median(took), 50.0),
        Verdict("memory of a script, in MB", loads[-2] / 1024, 0.5),
    ]
    results = Results(load.rows(), verdicts)
    rows: Sequence[Sequence[tables.Cell]] = [
        (kind, *Summary.of(of[kind]).arrivals(sent)) for kind in _KINDS
    ]
    results.table("scripts", f"{size} from a source to a receiver, time to arrival", HEADER, rows)
    results.table("script_loads", "loading scripts into a nodelet manager", LOADS, [loads])
    return results


def _load(chains: Chains, count: int) -> Tuple[List[float], Sequence[float]]:
    """Load scripts; returns the ms that each took, and a row under ``LOADS``."""
    took: List[float] = []
    before = (0, 0)
    for number in range(1, _BEFORE + count + 1):
        if number == _BEFORE + 1:
            before = held([chains.python.pid])
        begin = time.monotonic()
        chains.load_script("/benchmark/loaded", "hop", "time", number)
        if number > _BEFORE:
            took.append((time.monotonic() - begin) * 1e3)
    kib, threads = (now - then for now, then in zip(held([chains.python.pid]), before))
    spread = Summary.of(took)
    row = (count, spread.median, spread.p99, spread.max, kib / count, threads / count)
    return took, row
