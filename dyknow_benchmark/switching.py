# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ports that are connected elsewhere while messages flow."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from statistics import median
from typing import Sequence

import psutil
import rospy
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import SetConfig
from std_srvs.srv import Trigger

from dyknow.ros.process.owned import START_TIMEOUT
from dyknow_benchmark.chains import MANAGERS, PAIR, WARM_UP, ChainPart, Order, build, paired
from dyknow_benchmark.options import measurement
from dyknow_benchmark.results import Results, Row, Summary, median_interval, spread
from dyknow_benchmark.session import MeasurementFailed, Session, say, seconds, steps

_CONTROL = "/benchmark/switch"
#: Ports that are switched, with their nodelet and the two topics.
_ENDS = {"in": ("sink", ("even", "odd")), "out": ("source", ("left", "right"))}
#: Topics of the ports of both nodelets at first.
_WIRED = {**{each: each for each in ("even", "odd", "left", "right")}, "in": "even", "out": "left"}
_PAUSE = 2.0  # periods between two switches of one port, so that messages of each topic arrive


class _Port:
    """A port that is connected to one of two topics by turns."""

    def __init__(self, nodelet: str, port: str, topics: Sequence[str]) -> None:
        self._set_config = rospy.ServiceProxy(f"{nodelet}/set_config", SetConfig, persistent=True)
        self._set_config.wait_for_service(START_TIMEOUT)
        self._port, self._topics, self._side = port, topics, 0

    def switch(self) -> float:
        """Connect it to its other topic; returns when (s since the epoch) that was requested."""
        self._side = 1 - self._side
        config = [PortConfig(self._port, self._topics[self._side])]
        asked = time.time()
        answer = self._set_config(config)
        if not answer.success:
            raise MeasurementFailed(f"set_config refused: {answer.message}")
        return asked


@measurement(switches=10_000, rate=1000.0)
def rewire(arguments: argparse.Namespace, results: Results) -> None:
    """From a set_config call to the first message of the new topic.

    The client is another process with a persistent ServiceProxy, both topics are live, and the
    messages of both carry numbers, by which lost and doubled messages are counted. In turns an
    in-port and an out-port are switched. The time includes the wait for the next message, half a
    period on average.
    """
    count, ends = arguments.switches, list(_ENDS)
    topics = {f"{_CONTROL}/{port}": f"{_CONTROL}/{topic}" for port, topic in _WIRED.items()}
    asked: dict[str, list[float]] = {end: [] for end in ends}
    with Session() as session:
        manager = session.nodelet_manager()
        manager.load(f"{_CONTROL}/sink", "dyknow_benchmark/SwitchSink", topics)
        source = "dyknow_benchmark/SwitchSource"
        manager.load(f"{_CONTROL}/source", source, topics, rate=arguments.rate)
        ports = {
            end: _Port(f"{_CONTROL}/{nodelet}", end, [f"{_CONTROL}/{each}" for each in sides])
            for end, (nodelet, sides) in _ENDS.items()
        }
        for number in steps(range(count), "rewire", "switch"):
            end = ends[number % len(ends)]
            asked[end].append(ports[end].switch())
            time.sleep(_PAUSE / arguments.rate)
        time.sleep(0.2)
        services = [f"{_CONTROL}/sink/report_{end}" for end in ends]
        reports = [json.loads(rospy.ServiceProxy(each, Trigger)().message) for each in services]
    rows: list[Row] = []
    every: list[float] = []
    for end, (lost, doubled, *changes) in zip(ends, reports):
        took = delays(asked[end], changes)
        every += took
        counts = (len(asked[end]), len(took), int(lost), int(doubled))
        rows.append((end, *counts, *Summary.of(took).spread))
    header = ("port", "switches", "seen", "lost", "doubled", *spread("ms"))
    results.table("rewire", "re-wiring in-process", header, rows)
    results.verdict("set_config to first message, median (ms)", Summary.of(every).median, 2.0)
    for number, what in enumerate(("lost", "doubled")):
        results.verdict(f"{what} in {count} switches", sum(int(r[number]) for r in reports), 0)


def delays(asked: Sequence[float], arrived: Sequence[float]) -> list[float]:
    """Milliseconds from each request to the first message of its new topic.

    A request before whose successor no new topic was seen (the machine was too busy) has none.
    """
    found = []
    for begin, end in zip(asked, [*asked[1:], float("inf")]):
        first = next((each for each in arrived if begin <= each < end), None)
        if first is not None:
            found.append((first - begin) * 1000)
    return found


@measurement(hops=50, pairs=40, rate=100.0, switches=500)
def cpp(arguments: argparse.Namespace, results: Results) -> None:
    """What live ports add to C++ nodelets, and how long a switch of them takes.

    Of two chains of the same C++ nodelets, one is in the stock nodelet manager and one in
    DyKnow's; their messages alternate. Each pair of blocks yields a difference of the median
    times to arrival, and a difference of the processor time that the two processes took. Then
    ports of the last hop are connected elsewhere.
    """
    hops, stock, live = arguments.hops, "cpp_nodelet", "cpp_live"
    order = Order(WARM_UP, PAIR, arguments.rate)
    arrivals: list[float] = []
    costs: list[float] = []
    with Session() as session:
        chains = {kind: build(session, kind, hops) for kind in (stock, live)}
        processes = [session.nodelet_manager(MANAGERS[kind]).process for kind in (stock, live)]
        used = [_processor_time(process) for process in processes]
        for blocks in paired(chains, order, arguments.pairs):
            arrivals.append(blocks[live].median(hops) - blocks[stock].median(hops))
            before, used = used, [_processor_time(process) for process in processes]
            plain, ours = (now - then for now, then in zip(used, before))
            costs.append((ours - plain) / ((order.warm_up + order.count) * hops))
        say("connecting ports elsewhere")
        part = ChainPart(chains[live].control, "time", hops)
        elsewhere = {"in": f"{part.control}/hop_{max(hops - 2, 0)}", "out": f"{part.node}/out"}
        switched = {}
        for end, topic in elsewhere.items():
            port = _Port(part.node, end, (part.remappings[end], topic))
            switched[end] = [1e3 * seconds(port.switch) for _ in range(arguments.switches)]
    rows: list[Row] = [
        (what, len(values), median(values), *median_interval(values))
        for what, values in (("arrival, us", arrivals), ("processor time of a hop, us", costs))
    ]
    differences = ("difference", "pairs", "median", "low", "high")
    results.table("cpp_ports", "what live ports add to C++ nodelets", differences, rows)
    rows = [(end, len(times), *Summary.of(times).spread) for end, times in switched.items()]
    header = ("port", "switches", *spread("ms"))
    results.table("cpp_switches", "set_config of C++ nodelets", header, rows)
    results.verdict(f"live ports add over {hops} hops, in ms", median(arrivals) / 1e3, 0.1)
    results.verdict("live ports add to a hop, in us of processor time", median(costs), 0.2)
    results.verdict("set_config in C++, median in ms", max(map(median, switched.values())), 4.0)


def _processor_time(process: psutil.Process) -> float:
    """Microseconds that all threads of a process have run."""
    tasks = Path(f"/proc/{process.pid}/task").glob("*/schedstat")
    return sum(int(each.read_text().split()[0]) for each in tasks) / 1e3
