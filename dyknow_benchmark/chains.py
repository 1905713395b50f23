# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The chains that are compared: their kinds, how each is set up, and how they are measured."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass, field
from statistics import median
from typing import Callable, Hashable, Iterator, Mapping, NamedTuple, Sequence, TypeVar

import rospy
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from dyknow.ros.process.programs import find_program
from dyknow_benchmark.session import MeasurementFailed, Session, offers, say, steps, wait_until

#: Descriptions of the kinds, in the order in which they are shown.
KINDS: dict[str, str] = {
    "dyknow": "DyKnow nodelets: ports, through the proxy",
    "isolated": "the same DyKnow nodelets, a nodelet manager for each hop",
    "nodelet": "plain Python nodelets of the same nodelet manager: topics, no proxy",
    "node": "rospy nodes, a process each",
    "script": "the same rospy nodes, unchanged, as scripts in DyKnow's nodelet manager",
    "cpp_nodelet": "C++ nodelets in the stock nodelet manager",
    "cpp_live": "the same C++ nodelets with live ports, in DyKnow's nodelet manager",
    "cpp_node": "C++ nodes, a process each",
}
#: Where the kinds that are nodelets run.
MANAGERS = {
    **dict.fromkeys(("dyknow", "isolated", "nodelet", "script"), "python"),
    "cpp_nodelet": "cpp",
    "cpp_live": "cpp_live",
}

#: Seconds between an order to send and the first message, so that the order has arrived.
_LEAD = 0.1
_TAIL = 1.0  # seconds without a further report after which a message counts as lost
#: Messages at the start of every block that do not count, and those that do, in turns.
WARM_UP, _BLOCK = 5, 50
PAIR = 25  # messages of each chain in a pair

K = TypeVar("K", bound=Hashable)


@dataclass
class Block:
    """Messages that were sent together: latencies (us) of those that arrived, by hop."""

    sent: int = 0
    latencies: dict[int, list[float]] = field(default_factory=dict)  # in the order of stamps

    def median(self, hop: int) -> float:
        """Median latency at a hop; raises MeasurementFailed if no message came there."""
        if not self.latencies[hop]:
            raise MeasurementFailed(f"no message came to hop {hop} of a chain")
        return median(self.latencies[hop])

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


def blocks_of(messages: int, frequency: float) -> list[Order]:
    sizes = (min(_BLOCK, messages - sent) for sent in range(0, messages, _BLOCK))
    return [Order(WARM_UP, size, frequency) for size in sizes]


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


def paired(chains: Mapping[K, Chain], order: Order, pairs: int) -> Iterator[Mapping[K, Block]]:
    """Yield blocks of chains that send at the same time; which is the first alternates."""
    keys = list(chains)
    for number in steps(range(pairs), "pairs", "pair"):
        some = keys if number % 2 == 0 else keys[::-1]
        yield alternating({key: chains[key] for key in some}, [order])


class Chain:
    """A chain that is set up, by its control namespace."""

    def __init__(self, session: Session, control: str, hops: Sequence[int]) -> None:
        """Connect to a chain whose ``hops`` report, and let a message go all the way through.

        Raises:
            DyKnowError: no message comes through.
        """
        self.control = control
        services = {hop: f"{control}/report_{hop}" for hop in sorted(hops)}
        self._reports = {
            hop: rospy.ServiceProxy(service, Trigger, persistent=True)
            for hop, service in services.items()
        }
        self._send = rospy.Publisher(f"{control}/send", Float64MultiArray, queue_size=10)

        def is_whole() -> bool:
            session.check()
            is_offered = all(map(offers, services.values()))
            return is_offered and all(self.run(Order(0, 1, 10.0)).latencies.values())

        wait_until(is_whole, f"a message at the hops {hops} of chain {control}")

    def run(self, order: Order) -> Block:
        return self.finish(order, self.begin(order))

    def begin(self, order: Order, delay: float = 0.0) -> float:
        """Tell the source to send; returns when (s since the epoch) it does."""
        start = time.time() + _LEAD + delay
        total = order.warm_up + order.count
        self._send.publish(Float64MultiArray(data=[total, order.frequency, start]))
        return start

    def finish(self, order: Order, start: float) -> Block:
        """Wait for the end of an order that ``begin`` sent, and collect the arrivals."""
        total, before = order.warm_up + order.count, -1
        arrivals: dict[int, dict[float, float]] = {hop: {} for hop in self._reports}
        time.sleep(max(0.0, start + total / order.frequency - time.time()))
        while True:
            for hop, report in self._reports.items():
                new = json.loads(report().message)
                arrivals[hop].update((stamp, each) for stamp, each in new if stamp >= start)
            counts = [len(each) for each in arrivals.values()]
            if sum(counts) != before:
                before, end = sum(counts), time.monotonic() + _TAIL
            if min(counts) >= total or time.monotonic() > end:
                return select(arrivals, order)
            time.sleep(0.02)


def select(arrivals: Mapping[int, Mapping[float, float]], order: Order) -> Block:
    """Leave out the warm-up: the earliest stamps that were seen at any hop."""
    counted = sorted(set().union(*arrivals.values()))[order.warm_up :]
    return Block(
        order.count,
        {
            hop: [seen[stamp] for stamp in counted if stamp in seen]
            for hop, seen in arrivals.items()
        },
    )


class ChainPart(NamedTuple):
    """A part of a chain, as ``parts`` describes it: a hop, or the source, which has number 0."""

    control: str
    payload: str
    hop: int
    record: bool = False

    @property
    def program(self) -> str:
        return "hop" if self.hop else "source"

    @property
    def node(self) -> str:
        """Name of the nodelet, if it is one."""
        return f"{self.control}/part_{self.hop}"

    @property
    def remappings(self) -> dict[str, str]:
        topics = (f"{self.control}/hop_{number}" for number in (self.hop, self.hop - 1))
        return dict(zip(("out", "in") if self.hop else ("out",), topics))


class FanPart(ChainPart):
    """A part of a fan: every hop receives what the source publishes."""

    __slots__ = ()

    @property
    def remappings(self) -> dict[str, str]:
        return {**super().remappings, **({"in": f"{self.control}/hop_0"} if self.hop else {})}


def build(
    session: Session,
    kind: str,
    length: int,
    record: Sequence[int] = (),
    payload: str = "time",
    name: str = "",
    part: type[ChainPart] = ChainPart,
) -> Chain:
    """Set up a chain and return once messages go all the way through it.

    Args:
        session: where it runs; nodelets share a manager of their language, but for isolated ones.
        kind: a key of ``KINDS``.
        length: number of hops.
        record: hops that report; the last one if none is named.
        payload: content of the messages: ``time``, or a size of images.
        name: suffix of the namespace, for several chains of one kind and payload.
        part: how its parts are connected.

    Raises:
        DyKnowError: it does not come up.
    """
    say(f"setting up {length} hops of {payload}: {KINDS[kind]}")
    control = f"/benchmark/{kind}_{payload}{name}"
    record = record or [length]
    for hop in range(length, -1, -1):  # the last first, so that each finds its listener
        add_part(session, kind, part(control, payload, hop, hop in record))
    return Chain(session, control, record)


def add_part(session: Session, kind: str, part: ChainPart) -> None:
    """Load a part of a chain into its nodelet manager, or start its process."""
    parameters = {**part._asdict(), "plain": kind == "nodelet"}
    if kind in MANAGERS:
        language = "Cpp" if kind.startswith("cpp") else ""
        node_type, words = f"dyknow_benchmark/{language}Chain{part.program.title()}", []
        if kind == "script":
            node_type, words = "dyknow/Script", ["dyknow/benchmark_node", part.program]
        topics = {f"{part.control}/{port}": topic for port, topic in part.remappings.items()}
        own = f"_{part.hop}" if kind == "isolated" else ""
        manager = session.nodelet_manager(MANAGERS[kind], own)
        manager.load(part.node, node_type, topics, words, **parameters)
        return
    given = {f"_{key}": value for key, value in parameters.items()}
    arguments = [f"{key}:={value}" for key, value in {**part.remappings, **given}.items()]
    if kind == "cpp_node":
        command = [find_program("dyknow", "benchmark_chain")]
    else:
        command = [sys.executable, "-m", "dyknow_benchmark.parts"]
    session.run([*command, part.program, *arguments])
