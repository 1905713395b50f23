"""``benchmark busy``: time to arrival over a chain while another nodelet burns CPU.

The other nodelet computes in Python without a pause: in the chain's own nodelet manager, where it
takes the interpreter in turns with the chain, or in a nodelet manager of its own, as ``isolated``
does. The three cases take turns in blocks.
"""

from __future__ import annotations

import argparse
from typing import Dict, Optional

from dyknow_benchmark import machine, options, progress
from dyknow_benchmark.chains import Chains
from dyknow_benchmark.control import Block, Order
from dyknow_benchmark.managers import RunningManager
from dyknow_benchmark.outcome import Results
from dyknow_benchmark.session import Session
from dyknow_benchmark.summary import Summary

HEADER = ("burner", "hops", "messages", "lost", "mean_us", "median_us", "p99_us", "max_us")
_BURNER = "/benchmark/burner"
_WARM_UP = 5
#: Messages in one block.
_BLOCK = 50


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--hops", type=options.positive, default=10)
    parser.add_argument("--rate", type=options.rate, default=20.0, help="Hz (%(default)g)")
    parser.add_argument(
        "--messages", type=options.positive, default=200, help="of each (default: %(default)d)"
    )


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    hops = arguments.hops
    turns = -(-arguments.messages // _BLOCK)
    order = Order(_WARM_UP, arguments.messages // turns, arguments.rate)
    with Session() as session:
        chains = Chains(session)
        chain = chains.build("dyknow", hops, [hops])
        cases: Dict[str, Optional[RunningManager]] = {
            "none": None,
            "same manager": chains.python,
            "own manager": RunningManager.python(session, "/manager_of_the_burner"),
        }
        blocks = {case: Block() for case in cases}
        load = machine.Load()
        steps = [case for _ in range(turns) for case in cases]
        for case in progress.steps(steps, "busy", len(steps)):
            manager = cases[case]
            if manager is not None:
                manager.load(_BURNER, "dyknow_benchmark/Burner")
            blocks[case].add(chain.finish(order, chain.begin(order)))
            if manager is not None:
                manager.unload(_BURNER)
    outcome = Results()
    rows = []
    for case, block in blocks.items():
        s = Summary.of(block.latencies[hops])
        row = (case, hops, s.count, block.sent - s.count, s.mean, s.median, s.p99, s.max)
        rows.append(row)
    outcome.table("busy", "time to arrival while another nodelet burns CPU", HEADER, rows)
    outcome.table("machine", "the machine", machine.HEADER, load.rows())
    return outcome
