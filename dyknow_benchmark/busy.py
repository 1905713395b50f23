# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

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
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import Session
from dyknow_benchmark.summary import ARRIVALS, Summary

HEADER = ("burner", "hops", *ARRIVALS)
_BURNER = "/benchmark/burner"


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
    turns, order = Order.in_turns(arguments.messages, arguments.rate)
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
    results = Results(load.rows())
    rows = [
        (case, hops, *Summary.of(block.latencies[hops]).arrivals(block.sent))
        for case, block in blocks.items()
    ]
    results.table("busy", "time to arrival while another nodelet burns CPU", HEADER, rows)
    return results
