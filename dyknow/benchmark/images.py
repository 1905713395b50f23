"""``benchmark images``: the same chain with images of 1920 x 1080 and with time stamps.

Messages pass by reference, so their size should not matter. Both chains run in one nodelet
manager, and their messages alternate. The source makes every image afresh, before it is stamped.
"""

from __future__ import annotations

import argparse
from typing import Dict

from dyknow.benchmark import machine, options, progress
from dyknow.benchmark.chains import Chains
from dyknow.benchmark.control import Block, Order, run_alternating
from dyknow.benchmark.outcome import Outcome
from dyknow.benchmark.session import Session
from dyknow.benchmark.summary import Summary
from dyknow.benchmark.targets import Verdict

HEADER = ("payload", "hops", "messages", "lost", "mean_us", "median_us", "p99_us", "max_us")
#: The most that an image may take longer than a time stamp.
LIMIT = 1.2
_WARM_UP = 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--hops", type=options.positive, default=50)
    parser.add_argument("--rate", type=float, default=20.0, help="Hz (default: %(default)g)")
    parser.add_argument(
        "--messages", type=options.positive, default=500, help="of each (default: %(default)d)"
    )


def run(arguments: argparse.Namespace) -> Outcome:
    """Measure and put the results together."""
    blocks: Dict[str, Block] = {"time": Block(), "image": Block()}
    turns = max(1, arguments.messages // 50)
    order = Order(_WARM_UP, arguments.messages // turns, arguments.rate)
    with Session() as session:
        chains = Chains(session)
        controls = {
            payload: chains.build("dyknow", arguments.hops, [arguments.hops], payload)
            for payload in blocks
        }
        load = machine.Load()
        for _ in progress.steps(range(turns), "images", turns):
            measured = run_alternating(list(controls.values()), order)
            for payload, block in zip(controls, measured):
                blocks[payload].add(block)
    summaries = {
        payload: Summary.of(block.latencies[arguments.hops]) for payload, block in blocks.items()
    }
    outcome = Outcome(
        [
            Verdict(
                f"median with images / median with time stamps, {arguments.hops} hops",
                summaries["image"].median / summaries["time"].median,
                LIMIT,
            )
        ]
    )
    hops = arguments.hops
    rows = [
        (name, hops, s.count, blocks[name].sent - s.count, s.mean, s.median, s.p99, s.max)
        for name, s in summaries.items()
    ]
    outcome.table("images", "time to arrival", HEADER, rows)
    outcome.table("machine", "the machine", machine.HEADER, load.rows())
    return outcome
