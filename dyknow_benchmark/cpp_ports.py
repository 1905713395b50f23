# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark cpp``: what live ports add to C++ nodelets, and how long a switch of them takes.

Of two chains of the same C++ nodelets, one is in the stock nodelet manager and one in DyKnow's;
their messages alternate. Each pair of blocks yields a difference of the median times to arrival,
and a difference of the processor time that the two processes took. Then ports of the last hop are
connected elsewhere. A chain of Python and C++ nodelets by turns is measured beside them.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Dict, List, Sequence, Tuple

import rospy
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import SetConfig

from dyknow_benchmark import machine, options, progress
from dyknow_benchmark.chains import Chains
from dyknow_benchmark.control import WARM_UP, Block, ChainControl, Order, run_alternating
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import MeasurementFailed, Session
from dyknow_benchmark.summary import ARRIVALS, Summary, median, median_interval
from dyknow_benchmark.targets import Verdict

HEADER = ("difference", "pairs", "median", "low", "high")
CHAINS = ("chain", "hops", *ARRIVALS)
SWITCHES = ("port", "switches", "mean_ms", "median_ms", "p99_ms", "max_ms")
_STOCK, _LIVE = "cpp_nodelet", "cpp_live"
#: Hops of the chain of both languages; each costs a connection between processes.
_MIXED = 10
_MESSAGES = 25


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--hops", type=options.positive, default=50, help="default: %(default)d")
    parser.add_argument("--pairs", type=options.positive, default=40, help="default: %(default)d")
    parser.add_argument("--rate", type=options.rate, default=100.0, help="default: %(default)g")
    parser.add_argument(
        "--switches", type=options.positive, default=500, help="default: %(default)d"
    )


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    hops = arguments.hops
    order = Order(WARM_UP, _MESSAGES, arguments.rate)
    with Session() as session:
        chains = Chains(session)
        controls: Dict[str, ChainControl] = {}
        for kind, length in ((_STOCK, hops), (_LIVE, hops), ("mixed", _MIXED)):
            progress.say(f"setting up {length} hops: {kind}")
            controls[kind] = chains.build(kind, length, [length])
        load = machine.Load()
        pids = {_STOCK: chains.cpp.pid, _LIVE: chains.cpp_live.pid}
        latencies: Dict[str, List[float]] = {_STOCK: [], _LIVE: []}
        times, costs = _pairs(arguments.pairs, hops, order, controls, pids, latencies)
        mixed = controls["mixed"]
        latencies["mixed"] = _latencies(mixed.finish(order, mixed.begin(order)), _MIXED)
        progress.say("connecting ports elsewhere")
        switches = _switch(controls[_LIVE].control, hops, arguments.switches)
    slowest = max(median(values) for values in switches.values())
    verdicts = [
        Verdict(f"live ports add over {hops} hops, in ms", median(times) / 1e3, 0.1),
        Verdict("live ports add to a hop, in us of processor time", median(costs), 0.2),
        Verdict("set_config in C++, median in ms", slowest, 4.0),
    ]
    results = Results(load.rows(), verdicts)
    rows = [
        (what, len(values), median(values), *median_interval(values))
        for what, values in (("arrival, us", times), ("processor time of a hop, us", costs))
    ]
    results.table("cpp_ports", "what live ports add to C++ nodelets", HEADER, rows)
    results.table(
        "cpp_chains",
        "time to arrival, in us",
        CHAINS,
        [
            (kind, _MIXED if kind == "mixed" else hops, *_arrivals(values))
            for kind, values in latencies.items()
        ],
    )
    results.table(
        "cpp_switches",
        "set_config of C++ nodelets",
        SWITCHES,
        [(port, len(values), *_spread(values)) for port, values in switches.items()],
    )
    return results


def _pairs(
    count: int,
    hops: int,
    order: Order,
    controls: Dict[str, ChainControl],
    pids: Dict[str, int],
    latencies: Dict[str, List[float]],
) -> Tuple[List[float], List[float]]:
    """Return differences, live minus stock: of median arrivals, and of processor time a hop."""
    times: List[float] = []
    costs: List[float] = []
    sent = order.warm_up + order.count
    for index in progress.steps(range(count), "pairs", count, "pair"):
        kinds = (_STOCK, _LIVE) if index % 2 == 0 else (_LIVE, _STOCK)
        before = {kind: _processor_time(pids[kind]) for kind in kinds}
        blocks = dict(zip(kinds, run_alternating([controls[kind] for kind in kinds], order)))
        after = {kind: _processor_time(pids[kind]) for kind in kinds}
        arrival = {kind: _latencies(blocks[kind], hops) for kind in kinds}
        for kind in kinds:
            latencies[kind] += arrival[kind]
        times.append(median(arrival[_LIVE]) - median(arrival[_STOCK]))
        cost = {kind: (after[kind] - before[kind]) / (sent * hops) for kind in kinds}
        costs.append(cost[_LIVE] - cost[_STOCK])
    return times, costs


def _latencies(block: Block, hop: int) -> List[float]:
    found = block.latencies.get(hop, [])
    if not found:
        raise MeasurementFailed("no message came through the chain")
    return found


def _processor_time(pid: int) -> float:
    """Microseconds that all threads of a process have run."""
    tasks = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(each.read_text().split()[0]) for each in tasks) / 1e3


def _switch(control: str, hops: int, count: int) -> Dict[str, List[float]]:
    """Connect both ports of the last hop back and forth; returns the ms of each call, by port."""
    nodelet = f"{control}/nodelet_{hops}"
    set_config = rospy.ServiceProxy(f"{nodelet}/set_config", SetConfig, persistent=True)
    topics = {
        "in": (f"{control}/hop_{max(hops - 2, 0)}", f"{control}/hop_{hops - 1}"),
        "out": (f"{control}/elsewhere", f"{control}/hop_{hops}"),
    }
    took: Dict[str, List[float]] = {port: [] for port in topics}
    for index in range(count):
        for port, places in topics.items():
            begin = time.monotonic()
            answer = set_config([PortConfig(port, places[index % 2])])
            took[port].append((time.monotonic() - begin) * 1e3)
            if not answer.success:
                raise MeasurementFailed(answer.message)
    set_config.close()
    return took


def _arrivals(values: Sequence[float]) -> Sequence[float]:
    return Summary.of(values).arrivals(len(values))


def _spread(values: Sequence[float]) -> Sequence[float]:
    summary = Summary.of(values)
    return (summary.mean, summary.median, summary.p99, summary.max)
