# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ports that are connected elsewhere while messages flow."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from statistics import median
from typing import NamedTuple, Sequence

import psutil
import rosgraph
import rospy
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import SetConfig
from std_msgs.msg import Empty, Float64MultiArray

from dyknow.locks import state_condition
from dyknow_benchmark.chains import WARM_UP, Order, alternating, build
from dyknow_benchmark.options import measurement, rate
from dyknow_benchmark.results import ARRIVALS, SPREAD, Results, Row, Summary, median_interval
from dyknow_benchmark.session import (
    START_PATIENCE,
    MeasurementFailed,
    RunningManager,
    Session,
    say,
    steps,
    wait_until,
)

_CONTROL = "/benchmark/switch"
#: Ends that can be switched, with the nodelet, its port and the two topics.
_ENDS = {
    "in": ("sink", "in", (f"{_CONTROL}/even", f"{_CONTROL}/odd")),
    "out": ("source", "out", (f"{_CONTROL}/left", f"{_CONTROL}/right")),
}
#: Periods between two switches of one port, so that messages of each topic arrive.
_PAUSE = 2.0
#: The longest wait (s) for connections and threads of unloaded nodelets to end.
_SETTLE = 10.0
#: Cycles before the first count: they fill pools and caches.
_CYCLES = 20
#: Hops of the chain of both languages, each a connection between processes; messages of a pair.
_MIXED, _MESSAGES = 10, 25


class Seen(NamedTuple):
    """The messages at a port that was switched.

    Attributes:
        lost: messages that should have come and did not.
        doubled: messages that came again, or too late.
        changes: when (s since the epoch) the first message of each new topic came.
    """

    lost: int
    doubled: int
    changes: tuple[float, ...]


class _Port:
    """A port that is connected to one of two topics by turns."""

    def __init__(self, nodelet: str, port: str, topics: Sequence[str]) -> None:
        self._set_config = rospy.ServiceProxy(f"{nodelet}/set_config", SetConfig, persistent=True)
        self._set_config.wait_for_service(START_PATIENCE)
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


class _Switching:
    """Two nodelets whose ports are switched; all four topics are live."""

    def __init__(self, manager: RunningManager, rate: float) -> None:
        self._reports: dict[int, list[float]] = {}
        self._changed = state_condition("switches")
        self._collect = rospy.Publisher(f"{_CONTROL}/collect", Empty, queue_size=10)
        keep = {f"{_CONTROL}/{side}": f"{_CONTROL}/{side}" for side in ("left", "right")}
        firsts = {f"{_CONTROL}/{end}": _ENDS[end][2][0] for end in _ENDS}
        sink, source = f"{_CONTROL}/sink", f"{_CONTROL}/source"
        remapped = {**keep, f"{_CONTROL}/in": firsts[f"{_CONTROL}/in"]}
        manager.load(sink, "dyknow_benchmark/SwitchSink", remapped, control=_CONTROL)
        remapped = {f"{_CONTROL}/{port}": f"{_CONTROL}/{port}" for port in ("even", "odd")}
        remapped[f"{_CONTROL}/out"] = firsts[f"{_CONTROL}/out"]
        manager.load(source, "dyknow_benchmark/SwitchSource", remapped, rate=rate)
        rospy.Subscriber(f"{_CONTROL}/report", Float64MultiArray, self._on_report)
        self.ports = {
            end: _Port(f"{_CONTROL}/{nodelet}", port, topics)
            for end, (nodelet, port, topics) in _ENDS.items()
        }
        wait_until(self._answers, "the nodelets that are switched to report")

    def collect(self) -> dict[str, Seen]:
        """Collect the counts of each port."""
        with self._changed:
            self._reports.clear()
        wait_until(self._answers, "the nodelets that are switched to report")
        with self._changed:
            reports = [self._reports[number] for number in range(len(_ENDS))]
        return {
            end: Seen(int(lost), int(doubled), tuple(changes))
            for end, (lost, doubled, *changes) in zip(_ENDS, reports)
        }

    def _answers(self) -> bool:
        self._collect.publish(Empty())
        with self._changed:
            return self._changed.wait_for(lambda: len(self._reports) == len(_ENDS), 0.1)

    def _on_report(self, report: Float64MultiArray) -> None:
        with self._changed:
            self._reports[report.layout.data_offset] = list(report.data)
            self._changed.notify_all()


@measurement(
    switches=10_000,
    rate={"type": rate, "default": 1000.0, "help": "messages per second and topic (%(default)g)"},
)
def rewire(arguments: argparse.Namespace) -> Results:
    """From a set_config call to the first message of the new topic.

    The client is another process with a persistent ServiceProxy, both topics are live, and the
    messages of both carry numbers, by which lost and doubled messages are counted. In turns an
    in-port and an out-port are switched. The time includes the wait for the next message, half a
    period on average.
    """
    count = arguments.switches
    asked: dict[str, list[float]] = {end: [] for end in _ENDS}
    with Session() as session:
        switching = _Switching(session.nodelet_manager(), arguments.rate)
        results = Results()
        for number in steps(range(count), "rewire", "switch"):
            end = list(_ENDS)[number % len(_ENDS)]
            asked[end].append(switching.ports[end].switch())
            time.sleep(_PAUSE / arguments.rate)
        time.sleep(0.2)
        seen = switching.collect()
    took = {end: delays(asked[end], seen[end].changes) for end in _ENDS}
    rows: list[Row] = []
    for end, times in took.items():
        counts = (len(asked[end]), len(times), seen[end].lost, seen[end].doubled)
        rows.append((end, *counts, *Summary.of(times).spread))
    header = ("port", "switches", "seen", "lost", "doubled", *SPREAD)
    results.table("rewire", "re-wiring in-process", header, rows)
    every = Summary.of([each for times in took.values() for each in times])
    results.verdict("set_config to first message, median (ms)", every.median, 2.0)
    results.verdict(f"lost in {count} switches", sum(each.lost for each in seen.values()), 0)
    results.verdict(f"doubled in {count} switches", sum(each.doubled for each in seen.values()), 0)
    return results


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
def cpp(arguments: argparse.Namespace) -> Results:
    """What live ports add to C++ nodelets, and how long a switch of them takes.

    Of two chains of the same C++ nodelets, one is in the stock nodelet manager and one in
    DyKnow's; their messages alternate. Each pair of blocks yields a difference of the median
    times to arrival, and a difference of the processor time that the two processes took. Then
    ports of the last hop are connected elsewhere. A chain of Python and C++ nodelets by turns is
    measured beside them.
    """
    hops, stock, live = arguments.hops, "cpp_nodelet", "cpp_live"
    order = Order(WARM_UP, _MESSAGES, arguments.rate)
    latencies: dict[str, list[float]] = {stock: [], live: [], "mixed": []}
    arrivals: list[float] = []
    costs: list[float] = []
    with Session() as session:
        chains = {kind: build(session, kind, hops) for kind in (stock, live)}
        mixed = build(session, "mixed", _MIXED)
        places = {stock: "cpp", live: "cpp_live"}
        processes = {kind: session.nodelet_manager(places[kind]).process for kind in places}
        results = Results()
        for number in steps(range(arguments.pairs), "pairs", "pair"):
            kinds = (stock, live) if number % 2 == 0 else (live, stock)
            used = {kind: -_processor_time(processes[kind]) for kind in kinds}
            blocks = alternating({kind: chains[kind] for kind in kinds}, [order])
            for kind in kinds:
                used[kind] += _processor_time(processes[kind])
                latencies[kind] += blocks[kind].latencies[hops]
            ours, plain = (blocks[kind].latencies[hops] for kind in (live, stock))
            if not ours or not plain:
                raise MeasurementFailed("no message came through the chain")
            arrivals.append(median(ours) - median(plain))
            costs.append((used[live] - used[stock]) / ((order.warm_up + order.count) * hops))
        latencies["mixed"] = mixed.run(order).latencies[_MIXED]
        say("connecting ports elsewhere")
        control = chains[live].control
        ports = {
            "in": (f"{control}/hop_{hops - 1}", f"{control}/hop_{max(hops - 2, 0)}"),
            "out": (f"{control}/hop_{hops}", f"{control}/elsewhere"),
        }
        switched = {}
        for end, topics in ports.items():
            port = _Port(f"{control}/nodelet_{hops}", end, topics)
            asked = [port.switch() for _ in range(arguments.switches)] + [time.time()]
            switched[end] = [1e3 * (after - before) for before, after in zip(asked, asked[1:])]
    rows: list[Row] = [
        (what, len(values), median(values), *median_interval(values))
        for what, values in (("arrival, us", arrivals), ("processor time of a hop, us", costs))
    ]
    differences = ("difference", "pairs", "median", "low", "high")
    results.table("cpp_ports", "what live ports add to C++ nodelets", differences, rows)
    rows = [
        (kind, _MIXED if kind == "mixed" else hops, *Summary.of(values).arrivals(len(values)))
        for kind, values in latencies.items()
    ]
    results.table("cpp_chains", "time to arrival, in us", ("chain", "hops", *ARRIVALS), rows)
    rows = [(end, len(times), *Summary.of(times).spread) for end, times in switched.items()]
    header = ("port", "switches", *SPREAD)
    results.table("cpp_switches", "set_config of C++ nodelets", header, rows)
    results.verdict(f"live ports add over {hops} hops, in ms", median(arrivals) / 1e3, 0.1)
    results.verdict("live ports add to a hop, in us of processor time", median(costs), 0.2)
    results.verdict("set_config in C++, median in ms", max(map(median, switched.values())), 4.0)
    return results


def _processor_time(process: psutil.Process) -> float:
    """Microseconds that all threads of a process have run."""
    tasks = Path(f"/proc/{process.pid}/task").glob("*/schedstat")
    return sum(int(each.read_text().split()[0]) for each in tasks) / 1e3


@measurement(cycles=1000)
def leak(arguments: argparse.Namespace) -> Results:
    """Leftovers of re-wiring and loading in a nodelet manager.

    File descriptors, threads and registrations of the manager are counted before and after many
    re-wirings and many cycles of load and unload; nothing may be left.
    """
    with Session() as session:
        manager = session.nodelet_manager()
        switching = _Switching(manager, rate=100.0)

        def cycle() -> None:
            for port in switching.ports.values():
                port.switch()
            ports = {
                f"/benchmark/leak/{port}": f"/benchmark/leak/{port}" for port in ("in", "out")
            }
            manager.load("/benchmark/leak/hop", "dyknow_benchmark/ChainHop", ports)
            manager.unload("/benchmark/leak/hop")

        results = Results()
        for _ in range(_CYCLES):
            cycle()
        before = _settled(manager)
        for _ in steps(range(arguments.cycles), "leak", "cycle"):
            cycle()
        after = _settled(manager)
    rows = [(name, before[name], after[name]) for name in before]
    title = "what the nodelet manager holds"
    results.table("leak", title, ("what", "before", "after"), rows)
    for name, then, now in rows[:-1]:
        results.verdict(f"{name} left by {arguments.cycles} cycles", now - then, 0)
    return results


def _settled(manager: RunningManager) -> dict[str, int]:
    """Count resources until two counts, a second apart, are the same, or time is up."""
    end = time.monotonic() + _SETTLE
    census: dict[str, int] = {}
    while time.monotonic() < end:
        before = census
        state = rosgraph.Master("/benchmark").getSystemState()
        census = {
            "file_descriptors": manager.process.num_fds(),
            "threads": manager.process.num_threads(),
            "registrations": sum(manager.name in nodes for kind in state for _, nodes in kind),
        }
        if census == before:
            break
        time.sleep(1.0)
    return {**census, "resident_kib": manager.process.memory_info().rss // 1024}
