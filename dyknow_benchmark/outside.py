# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark outside``: time to arrival over a chain that another process listens to.

All chains are in one nodelet manager; another process subscribes to a number of topics of each,
spread over its length. A message is serialised once for each topic that has subscribers outside.
The messages of the chains alternate.
"""

from __future__ import annotations

import argparse
from typing import List, Sequence, Set

import rospy

from dyknow.locks import state_lock
from dyknow_benchmark import machine, options, progress
from dyknow_benchmark.chains import Chains
from dyknow_benchmark.control import Block, ChainControl, Order, run_alternating
from dyknow_benchmark.parts import payload_of
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import Session, wait_until
from dyknow_benchmark.summary import ARRIVALS, Summary

HEADER = ("listened", "hops", *ARRIVALS)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--hops", type=options.positive, default=50)
    parser.add_argument(
        "--listened",
        nargs="+",
        type=int,
        default=[0, 1, 10, 50],
        metavar="N",
        help="topics that another process hears, of as many chains (default: 0 1 10 50)",
    )
    parser.add_argument(
        "--payload", type=options.payload, default="time", help="time, or a size of images"
    )
    parser.add_argument("--rate", type=options.rate, default=20.0, help="Hz (%(default)g)")
    parser.add_argument(
        "--messages", type=options.positive, default=200, help="of each (default: %(default)d)"
    )


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    hops = arguments.hops
    numbers = sorted({min(hops, max(0, number)) for number in arguments.listened})
    turns, order = Order.in_turns(arguments.messages, arguments.rate)
    with Session() as session:
        chains = Chains(session)
        controls = []
        for number in numbers:
            progress.say(f"setting up {hops} hops, {number} of them heard outside")
            name = f"_heard_{number}"
            chain = chains.build("dyknow", hops, [hops], arguments.payload, name)
            _Listener(chain.control, spread(hops, number), arguments.payload).settle(chain)
            controls.append(chain)
        load = machine.Load()
        blocks = [Block() for _ in numbers]
        for _ in progress.steps(range(turns), "outside", turns):
            for block, measured in zip(blocks, run_alternating(controls, order)):
                block.add(measured)
    results = Results(load.rows())
    rows = [
        (number, hops, *Summary.of(block.latencies[hops]).arrivals(block.sent))
        for number, block in zip(numbers, blocks)
    ]
    results.table("outside", "time to arrival with subscribers outside", HEADER, rows)
    return results


def spread(hops: int, count: int) -> List[int]:
    """As many of the numbers from 1 to ``hops`` at even distances, the last among them."""
    return [hops - index * hops // count for index in range(count)][::-1]


class _Listener:
    """Subscribes, in this process, to what some hops of a chain publish."""

    def __init__(self, control: str, numbers: Sequence[int], payload: str) -> None:
        self._lock = state_lock("arrivals")
        self._silent: Set[int] = set(numbers)
        datatype = payload_of(payload).datatype
        for number in numbers:
            rospy.Subscriber(f"{control}/hop_{number}", datatype, self._hear, callback_args=number)

    def settle(self, chain: ChainControl) -> None:
        """Send messages until each subscription has had one.

        Raises:
            MeasurementFailed: that does not happen.
        """
        once = Order(0, 1, 10.0)

        def heard() -> bool:
            chain.finish(once, chain.begin(once))
            with self._lock:
                return not self._silent

        wait_until(heard, f"the messages of {chain.control} outside")

    def _hear(self, message: object, number: int) -> None:
        with self._lock:
            self._silent.discard(number)
