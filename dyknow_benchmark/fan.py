# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark fan``: time from one publisher until the last of many subscribers has a message.

The receivers are those of the chain, all of which listen to the source. The kinds take turns in
blocks.
"""

from __future__ import annotations

import argparse
from typing import Dict, List, Tuple

from dyknow_benchmark import machine, options, progress
from dyknow_benchmark.chains import Chains
from dyknow_benchmark.control import Block, Order
from dyknow_benchmark.kinds import KINDS
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import Session
from dyknow_benchmark.summary import ARRIVALS, Summary
from dyknow_benchmark.tables import Cell

HEADER = ("kind", "receivers", *ARRIVALS)
_KINDS = ("dyknow", "nodelet", "cpp_nodelet")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--kinds", nargs="+", choices=_KINDS, default=list(_KINDS), help="default: all"
    )
    parser.add_argument(
        "--receivers", nargs="+", type=options.positive, default=[1, 10, 50], metavar="N"
    )
    parser.add_argument("--rate", type=options.rate, default=100.0, help="Hz (%(default)g)")
    parser.add_argument(
        "--messages", type=options.positive, default=500, help="of each (default: %(default)d)"
    )


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    blocks: Dict[Tuple[str, int], List[Block]] = {
        (kind, receivers): []
        for kind in dict.fromkeys(arguments.kinds)
        for receivers in sorted(set(arguments.receivers))
    }
    turns, order = Order.in_turns(arguments.messages, arguments.rate)
    with Session() as session:
        chains = Chains(session)
        controls = {}
        for kind, receivers in blocks:
            progress.say(f"setting up {receivers} receivers: {KINDS[kind]}")
            controls[kind, receivers] = chains.build_fan(kind, receivers)
        load = machine.Load()
        steps = [key for _ in range(turns) for key in blocks]
        for key in progress.steps(steps, "fan", len(steps)):
            blocks[key].append(controls[key].finish(order, controls[key].begin(order)))
    results = Results(load.rows())
    rows: List[Tuple[Cell, ...]] = []
    for (kind, receivers), measured in blocks.items():
        summary = Summary.of([last for block in measured for last in last_arrivals(block)])
        sent = sum(block.sent for block in measured)
        rows.append((kind, receivers, *summary.arrivals(sent)))
    results.table("fan", "time to arrival at the last receiver", HEADER, rows)
    return results


def last_arrivals(block: Block) -> List[float]:
    """Microseconds until all receivers had each message.

    Which message a receiver missed is unknown: a block with a gap is left out as a whole.
    """
    latencies = list(block.latencies.values())
    if any(len(each) != block.sent for each in latencies):
        return []
    return [max(message) for message in zip(*latencies)]
