# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The chains that are compared: their kinds, how each is set up, and how they are measured."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from typing import Callable, Hashable, Mapping, Sequence, TypeVar

import rospy
from std_msgs.msg import Empty, Float64MultiArray

from dyknow.locks import state_condition
from dyknow_benchmark.session import (
    START_PATIENCE,
    MeasurementFailed,
    RunningManager,
    Session,
    executable,
    say,
    steps,
)

#: Descriptions of the kinds, in the order in which they are shown.
KINDS: dict[str, str] = {
    "dyknow": "DyKnow nodelets: ports, through the proxy",
    "nodelet": "plain Python nodelets of the same nodelet manager: topics, no proxy",
    "function": "Python functions that call each other",
    "node": "rospy nodes, a process each",
    "script": "the same rospy nodes, unchanged, as scripts in DyKnow's nodelet manager",
    "cpp_nodelet": "C++ nodelets in the stock nodelet manager",
    "cpp_live": "the same C++ nodelets with live ports, in DyKnow's nodelet manager",
    "cpp_node": "C++ nodes, a process each",
}
#: Kinds of nodelets: their nodelet manager, and the prefix of the names of their classes.
NODELETS = {
    "dyknow": ("python", ""),
    "nodelet": ("python", "Plain"),
    "cpp_nodelet": ("cpp", "Cpp"),
    "cpp_live": ("cpp_live", "Cpp"),
}

#: Seconds between an order to send and the first message, so that the order has arrived.
_LEAD = 0.1
#: Seconds without a further report after which a message counts as lost.
_TAIL = 1.0
#: Messages at the start of every block that do not count, and those that do, in turns.
WARM_UP, _BLOCK = 5, 50

K = TypeVar("K", bound=Hashable)


@dataclass
class Block:
    """The result of some messages that were sent together.

    Attributes:
        sent: number of messages that count.
        latencies: microseconds of those that arrived, by hop, in the order of their stamps.
    """

    sent: int = 0
    latencies: dict[int, list[float]] = field(default_factory=dict)

    def add(self, other: Block) -> None:
        """Put the messages of ``other`` to these."""
        self.sent += other.sent
        for hop, latencies in other.latencies.items():
            self.latencies.setdefault(hop, []).extend(latencies)


@dataclass(frozen=True)
class Order:
    """An order to a source: send messages that do not count, then some that do, at Hz."""

    warm_up: int
    count: int
    frequency: float


def blocks_of(messages: int, frequency: float, turns: int = 0) -> list[Order]:
    """Divide messages into blocks of nearly the same size, as many as there are turns."""
    turns = turns or -(-messages // _BLOCK)
    size, rest = divmod(messages, turns)
    sizes = [size + (number < rest) for number in range(turns)]
    return [Order(WARM_UP, each, frequency) for each in sizes if each]


def in_turns(
    cases: Mapping[K, Callable[[Order], Block]], orders: Sequence[Order]
) -> dict[K, Block]:
    """Let cases take turns in blocks, so that a drift of the machine's speed meets them all."""
    blocks = {case: Block() for case in cases}
    keys = list(cases)
    turns = [
        (order, case)
        for number, order in enumerate(orders)
        for case in (keys if number % 2 == 0 else keys[::-1])
    ]
    for order, case in steps(turns, "measuring"):
        blocks[case].add(cases[case](order))
    return blocks


def alternating(chains: Mapping[K, Chain], orders: Sequence[Order]) -> dict[K, Block]:
    """Let chains send at the same time, one message of each after the other."""
    blocks = {case: Block() for case in chains}
    for order in steps(orders, "measuring"):
        step = 1.0 / (order.frequency * len(chains))
        starts = [chain.begin(order, index * step) for index, chain in enumerate(chains.values())]
        for (case, chain), start in zip(chains.items(), starts):
            blocks[case].add(chain.finish(order, start))
    return blocks


class Chain:
    """A chain that is set up, by its control topics."""

    def __init__(self, session: Session, control: str, hops: Sequence[int]) -> None:
        """Connect to a chain whose ``hops`` report, and let a message go all the way through.

        Raises:
            MeasurementFailed: no message comes through.
        """
        self.control = control
        self._changed = state_condition("reports")
        self._arrivals: dict[int, dict[float, float]] = {hop: {} for hop in sorted(hops)}
        self._send = rospy.Publisher(f"{control}/send", Float64MultiArray, queue_size=10)
        self._collect = rospy.Publisher(f"{control}/collect", Empty, queue_size=10)
        rospy.Subscriber(f"{control}/report", Float64MultiArray, self._on_report)
        end = time.monotonic() + START_PATIENCE
        missing = list(hops)
        while missing:
            session.check()
            if time.monotonic() > end:
                raise MeasurementFailed(
                    f"chain {control}: no message came to hops {missing} "
                    f"within {START_PATIENCE:g} s"
                )
            start = self.begin(Order(0, 1, 10.0))
            self._await(start, 1, 0.3)
            missing = [hop for hop, seen in self._since(start).items() if not seen]

    def run(self, order: Order) -> Block:
        """Send messages and collect the arrivals."""
        return self.finish(order, self.begin(order))

    def begin(self, order: Order, delay: float = 0.0) -> float:
        """Tell the source to send; returns when (s since the epoch) it does."""
        start = time.time() + _LEAD + delay
        total = order.warm_up + order.count
        self._send.publish(Float64MultiArray(data=[total, order.frequency, start]))
        return start

    def finish(self, order: Order, start: float) -> Block:
        """Wait for the end of an order that ``begin`` sent, and collect the arrivals."""
        total = order.warm_up + order.count
        time.sleep(max(0.0, start + total / order.frequency - time.time()))
        self._await(start, total, _TAIL)
        return select(self._since(start), order)

    def _await(self, first: float, count: int, patience: float) -> None:
        """Collect until all hops saw ``count`` messages, or nothing new came for a while."""

        def seen() -> list[int]:
            return [len(each) for each in self._since(first).values()]

        end, before = time.monotonic() + patience, -1
        while time.monotonic() < end and min(seen()) < count:
            self._collect.publish(Empty())
            with self._changed:
                self._changed.wait(0.05)
            if sum(seen()) != before:
                before, end = sum(seen()), time.monotonic() + patience

    def _since(self, first: float) -> dict[int, dict[float, float]]:
        with self._changed:
            return {
                hop: {stamp: latency for stamp, latency in seen.items() if stamp >= first}
                for hop, seen in self._arrivals.items()
            }

    def _on_report(self, report: Float64MultiArray) -> None:
        with self._changed:
            seen = self._arrivals.get(report.layout.data_offset, {})
            seen.update(zip(report.data[::2], report.data[1::2]))
            self._changed.notify_all()


def select(arrivals: Mapping[int, Mapping[float, float]], order: Order) -> Block:
    """Leave out the warm-up: the earliest stamps that were seen at any hop.

    Args:
        arrivals: latency by stamp, by hop.
        order: the messages that were sent.
    """
    counted = sorted(set().union(*arrivals.values()))[order.warm_up :]
    return Block(
        order.count,
        {
            hop: [seen[stamp] for stamp in counted if stamp in seen]
            for hop, seen in arrivals.items()
        },
    )


def build(
    session: Session,
    kind: str,
    length: int,
    record: Sequence[int] = (),
    payload: str = "time",
    name: str = "",
) -> Chain:
    """Set up a chain and return once messages go all the way through it.

    Args:
        session: where it runs; nodelets share one manager of their language.
        kind: a key of ``KINDS``, or ``mixed``: DyKnow nodelets and C++ ones with live ports by
            turns.
        length: number of hops.
        record: hops that report; the last one if none is named.
        payload: content of the messages: ``time``, or a size of images.
        name: suffix of the namespace, for several chains of one kind and payload.

    Raises:
        MeasurementFailed: it does not come up.
    """
    say(f"setting up {length} hops of {payload}: {KINDS.get(kind, kind)}")
    control = f"/benchmark/{kind}_{payload}{name}"
    record = record or [length]
    hops = range(length, 0, -1)  # the last first, so that each finds its listener
    if kind in (*NODELETS, "mixed"):
        kinds = (kind, kind) if kind in NODELETS else ("cpp_live", "dyknow")
        for hop in hops:
            load_hop(session, kinds[hop % 2], control, hop, hop in record, payload)
        place, prefix = NODELETS[kinds[1]]
        session.nodelet_manager(place).load(
            f"{control}/source",
            f"dyknow_benchmark/{prefix}ChainSource",
            {f"{control}/out": f"{control}/hop_0"},
            control=control,
            payload=payload,
        )
    elif kind == "function":
        _start(session, "function", control, payload, length, record)
    elif kind == "cpp_node":
        program = executable("dyknow", "benchmark_chain")
        for hop in hops:
            topics = [f"in:={control}/hop_{hop - 1}", f"out:={control}/hop_{hop}"]
            is_recorded = str(hop in record).lower()
            parameters = [f"_control:={control}", f"_hop:={hop}", f"_record:={is_recorded}"]
            session.start([program, "hop", *topics, *parameters])
        session.start([program, "source", f"out:={control}/hop_0", f"_control:={control}"])
    else:
        start = {"node": _start, "script": load_script}[kind]
        for hop in hops:
            start(session, "hop", control, payload, hop, record)
        start(session, "source", control, payload, 0, ())
    return Chain(session, control, record)


def load_hop(
    session: Session, kind: str, control: str, hop: int, record: bool, payload: str = "time"
) -> RunningManager:
    """Load one hop of a chain of nodelets; returns where it runs."""
    place, prefix = NODELETS[kind]
    manager = session.nodelet_manager(place)
    manager.load(
        f"{control}/nodelet_{hop}",
        f"dyknow_benchmark/{prefix}ChainHop",
        {f"{control}/in": f"{control}/hop_{hop - 1}", f"{control}/out": f"{control}/hop_{hop}"},
        control=control,
        payload=payload,
        hop=hop,
        record=record,
    )
    return manager


def _words(part: str, control: str, payload: str, hop: int, record: Sequence[int]) -> list[str]:
    options = ["--control", control, "--payload", payload, "--hop", str(hop), "--record"]
    return [part, *options, *map(str, record)]


def load_script(
    session: Session, part: str, control: str, payload: str, hop: int, record: Sequence[int]
) -> None:
    """Load a part of a chain that is a script: a hop, with its number, or the source."""
    words = ["dyknow/benchmark_node", *_words(part, control, payload, hop, record)]
    session.nodelet_manager().load(f"{control}/{part}_{hop}", "dyknow/Script", my_argv=words)


def _start(
    session: Session, part: str, control: str, payload: str, hop: int, record: Sequence[int]
) -> None:
    words = _words(part, control, payload, hop, record)
    session.start([sys.executable, "-m", "dyknow_benchmark.parts", *words])
