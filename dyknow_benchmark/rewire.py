# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark rewire``: from a set_config call to the first message of the new topic.

The client is another process with a persistent ServiceProxy, both topics are live, and the
messages of both carry numbers, by which lost and doubled messages are counted. In turns an in-port
and an out-port are switched. The time includes the wait for the next message, half a period on
average.
"""

from __future__ import annotations

import argparse
import time
from typing import Dict, List, Sequence, Tuple

from dyknow_benchmark import machine, options, progress
from dyknow_benchmark.managers import RunningManager
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import Session
from dyknow_benchmark.summary import Summary
from dyknow_benchmark.switching import ENDS, Seen, Switching
from dyknow_benchmark.tables import Cell
from dyknow_benchmark.targets import Verdict

COUNTS = ("switches", "seen", "lost", "doubled")
HEADER = ("port", *COUNTS, "mean_ms", "median_ms", "p99_ms", "max_ms")
#: The most milliseconds that a switch may take at the median.
LIMIT = 2.0
#: Periods between two switches of one port, so that messages of each topic arrive.
_PAUSE = 2.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--switches", type=options.positive, default=10_000, help="default: %(default)d"
    )
    parser.add_argument(
        "--rate",
        type=options.rate,
        default=1000.0,
        help="messages per second and topic (%(default)g)",
    )


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    asked: Dict[str, List[float]] = {end: [] for end in ENDS}
    with Session() as session:
        switching = Switching(RunningManager.python(session), arguments.rate)
        load = machine.Load()
        for number in progress.steps(
            range(arguments.switches), "rewire", arguments.switches, "switch"
        ):
            end = ENDS[number % len(ENDS)]
            asked[end].append(switching.switch(end))
            time.sleep(_PAUSE / arguments.rate)
        time.sleep(0.2)
        seen = {end: switching.collect(end) for end in ENDS}
    times = {end: delays(asked[end], seen[end].changes) for end in ENDS}
    summaries = {end: Summary.of(values) for end, values in times.items()}
    rows = [_row(end, len(asked[end]), seen[end], summaries[end]) for end in ENDS]
    lost = sum(each.lost for each in seen.values())
    doubled = sum(each.doubled for each in seen.values())
    overall = Summary.of([value for values in times.values() for value in values])
    results = Results(
        load.rows(),
        [
            Verdict("set_config to first message, median (ms)", overall.median, LIMIT),
            Verdict(f"lost in {arguments.switches} switches", lost, 0),
            Verdict(f"doubled in {arguments.switches} switches", doubled, 0),
        ],
    )
    results.table("rewire", "re-wiring in-process", HEADER, rows)
    return results


def _row(end: str, switches: int, seen: Seen, times: Summary) -> Tuple[Cell, ...]:
    counts = (switches, times.count, seen.lost, seen.doubled)
    return (end, *counts, times.mean, times.median, times.p99, times.max)


def delays(asked: Sequence[float], arrived: Sequence[float]) -> List[float]:
    """Milliseconds from each request to the first message of its new topic.

    A request before whose successor no new topic was seen (the machine was too busy) has none.
    """
    found = []
    position = 0
    for index, begin in enumerate(asked):
        end = asked[index + 1] if index + 1 < len(asked) else float("inf")
        while position < len(arrived) and arrived[position] < begin:
            position += 1
        if position < len(arrived) and arrived[position] < end:
            found.append((arrived[position] - begin) * 1000)
    return found
