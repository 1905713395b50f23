# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The measuring side: tells the sources of chains to send, and collects the hops' reports."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Dict, List, Sequence, Tuple

import rospy
from std_msgs.msg import Empty, Float64MultiArray

from dyknow.locks import state_condition
from dyknow_benchmark.session import START_PATIENCE, MeasurementFailed, Session

#: Seconds between an order to send and the first message, so that the order has arrived.
LEAD = 0.1
#: Seconds without a further report after which a message counts as lost.
TAIL = 1.0
#: Messages at the start of every block that do not count.
WARM_UP = 5
#: Messages in a block, where several chains take turns.
_BLOCK = 50


@dataclass
class Block:
    """The result of some messages that were sent together.

    Attributes:
        sent: number of messages that count.
        latencies: microseconds of those that arrived, by hop, in the order of their stamps.
    """

    sent: int = 0
    latencies: Dict[int, List[float]] = field(default_factory=dict)

    def add(self, other: Block) -> None:
        """Put the messages of ``other`` to these."""
        self.sent += other.sent
        for hop, latencies in other.latencies.items():
            self.latencies.setdefault(hop, []).extend(latencies)


@dataclass(frozen=True)
class Order:
    """What a source is told.

    Attributes:
        warm_up: messages that are sent first and do not count.
        count: messages that count.
        frequency: Hz.
    """

    warm_up: int
    count: int
    frequency: float

    @classmethod
    def in_turns(cls, messages: int, frequency: float) -> Tuple[int, Order]:
        """Divide messages into blocks; returns the number of turns and the order of each."""
        turns = -(-messages // _BLOCK)
        return turns, cls(WARM_UP, messages // turns, frequency)

    @property
    def duration(self) -> float:
        """Seconds from the first to after the last message."""
        return (self.warm_up + self.count) / self.frequency


class ChainControl:
    """The control topics of one chain."""

    def __init__(self, control: str, hops: Sequence[int]) -> None:
        """Connect to a chain.

        Args:
            control: namespace of the control topics.
            hops: the hops that report.
        """
        self.control = control
        self.hops = tuple(sorted(hops))
        self._changed = state_condition("reports")
        self._arrivals: Dict[int, Dict[float, float]] = {hop: {} for hop in self.hops}
        self._send = rospy.Publisher(control + "/send", Float64MultiArray, queue_size=10)
        self._collect = rospy.Publisher(control + "/collect", Empty, queue_size=10)
        self._reports = rospy.Subscriber(control + "/report", Float64MultiArray, self._on_report)

    def settle(self, session: Session) -> None:
        """Return once a message goes through the whole chain and all its reports come back.

        Raises:
            MeasurementFailed: that does not happen.
        """
        end = time.monotonic() + START_PATIENCE
        missing: Sequence[int] = self.hops
        while time.monotonic() < end:
            session.check()
            start = self.begin(Order(0, 1, 10.0))
            self._await(start, 1, 0.3)
            missing = [hop for hop in self.hops if not self._since(start)[hop]]
            if not missing:
                return
        raise MeasurementFailed(
            f"chain {self.control}: no message came to hops {list(missing)} "
            f"within {START_PATIENCE:g} s"
        )

    def begin(self, order: Order, delay: float = 0.0) -> float:
        """Tell the source to send; returns when (s since the epoch) it does."""
        start = time.time() + LEAD + delay
        total = order.warm_up + order.count
        self._send.publish(Float64MultiArray(data=[total, order.frequency, start]))
        return start

    def finish(self, order: Order, start: float) -> Block:
        """Wait for the end of what ``begin`` began and collect it."""
        time.sleep(max(0.0, start + order.duration - time.time()))
        self._await(start, order.warm_up + order.count, TAIL)
        return select(self._since(start), order)

    def close(self) -> None:
        """Disconnect."""
        self._reports.unregister()
        self._send.unregister()
        self._collect.unregister()

    def _await(self, first: float, count: int, patience: float) -> None:
        """Collect until all hops saw ``count`` messages, or nothing new came for a while."""

        def complete() -> bool:
            return all(len(seen) >= count for seen in self._since(first).values())

        end = time.monotonic() + patience
        before = -1
        while time.monotonic() < end:
            self._collect.publish(Empty())
            with self._changed:
                self._changed.wait_for(complete, 0.05)
                if complete():
                    return
            seen = sum(map(len, self._since(first).values()))
            if seen != before:
                before, end = seen, time.monotonic() + patience

    def _since(self, first: float) -> Dict[int, Dict[float, float]]:
        with self._changed:
            return {
                hop: {stamp: latency for stamp, latency in seen.items() if stamp >= first}
                for hop, seen in self._arrivals.items()
            }

    def _on_report(self, report: Float64MultiArray) -> None:
        seen = self._arrivals.get(report.layout.data_offset)
        if seen is None:
            return
        numbers = report.data
        with self._changed:
            seen.update(zip(numbers[::2], numbers[1::2]))
            self._changed.notify_all()


def select(arrivals: Dict[int, Dict[float, float]], order: Order) -> Block:
    """Leave out the warm-up: the earliest stamps that were seen at any hop.

    Args:
        arrivals: latency by stamp, by hop.
        order: what was sent.
    """
    stamps = sorted(set().union(*arrivals.values()))
    counted = stamps[order.warm_up :]
    return Block(
        order.count,
        {
            hop: [seen[stamp] for stamp in counted if stamp in seen]
            for hop, seen in arrivals.items()
        },
    )


def run_alternating(controls: Sequence[ChainControl], order: Order) -> List[Block]:
    """Let several chains send at the same frequency, one message of each after the other."""
    step = 1.0 / (order.frequency * len(controls))
    starts = [control.begin(order, index * step) for index, control in enumerate(controls)]
    return [control.finish(order, start) for control, start in zip(controls, starts)]
