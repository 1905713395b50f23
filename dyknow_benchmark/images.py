# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark images``: the same chain with images of growing size and with time stamps.

Messages pass by reference, so their size should not matter. All chains run in one nodelet
manager, and their messages alternate. The source makes every image afresh, before it is stamped.
"""

from __future__ import annotations

import argparse
from typing import Dict, Sequence

from dyknow_benchmark import machine, options, progress
from dyknow_benchmark.chains import Chains
from dyknow_benchmark.control import Block, Order, run_alternating
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import MeasurementFailed, Session
from dyknow_benchmark.summary import ARRIVALS, Summary
from dyknow_benchmark.targets import Verdict

HEADER = ("payload", "hops", *ARRIVALS)
SIZES = ("320x240", "640x480", "1280x720", "1920x1080")
#: The size that the target is stated for.
LARGEST = SIZES[-1]
#: The most that an image may take longer than a time stamp.
LIMIT = 1.2
#: Hz, of each payload.
RATE = 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--hops", type=options.positive, default=50)
    parser.add_argument(
        "--sizes",
        nargs="+",
        type=options.size,
        metavar="WIDTHxHEIGHT",
        default=list(SIZES),
        help=f"default: {' '.join(SIZES)}",
    )
    parser.add_argument(
        "--rate", type=options.rate, default=RATE, help="Hz (default: %(default)g)"
    )
    parser.add_argument(
        "--messages", type=options.positive, default=500, help="of each (default: %(default)d)"
    )


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    hops = arguments.hops
    payloads = ["time", *dict.fromkeys(arguments.sizes)]
    with Session() as session:
        chains = Chains(session)
        load = machine.Load()
        blocks = measure(chains, payloads, hops, arguments.rate, arguments.messages)
    results = Results(
        load.rows(), [verdict(blocks, size, hops) for size in payloads[1:] if size == LARGEST]
    )
    rows = [
        (name, hops, *Summary.of(block.latencies[hops]).arrivals(block.sent))
        for name, block in blocks.items()
    ]
    results.table("images", "time to arrival", HEADER, rows)
    return results


def measure(
    chains: Chains, payloads: Sequence[str], hops: int, rate: float, messages: int
) -> Dict[str, Block]:
    """Let a chain of DyKnow's nodelets for each payload send in turns.

    Args:
        chains: where they are set up.
        payloads: what they carry.
        hops: their length.
        rate: Hz, of each.
        messages: of each.
    """
    controls = []
    for payload in payloads:
        progress.say(f"setting up {hops} hops: {payload}")
        controls.append(chains.build("dyknow", hops, [hops], payload, "_alternating"))
    blocks = {payload: Block() for payload in payloads}
    turns, order = Order.in_turns(messages, rate)
    for _ in progress.steps(range(turns), "images", turns):
        for payload, block in zip(payloads, run_alternating(controls, order)):
            blocks[payload].add(block)
    return blocks


def verdict(blocks: Dict[str, Block], size: str, hops: int) -> Verdict:
    """Compare images with time stamps.

    Medians, because one message that the machine delays would outweigh all that is measured.
    """
    image, stamp = (Summary.of(blocks[name].latencies[hops]) for name in (size, "time"))
    if not image.count or not stamp.count:
        raise MeasurementFailed(f"no message came through {hops} hops")
    what = f"median with images of {size} / with time stamps, {hops} hops"
    return Verdict(what, image.median / stamp.median, LIMIT)
