# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The topics by which the measuring process controls the parts of a chain.

Below a control namespace there are three topics, the same for the parts in C++
(``cpp/chain.h``): ``send`` (Float64MultiArray: count, frequency in Hz, start in s since the
epoch), ``collect`` (Empty) and ``report`` (Float64MultiArray: stamp in s, latency in us, …;
``layout.data_offset`` is the hop).
"""

from __future__ import annotations

from typing import Any, List, Protocol

from std_msgs.msg import Empty, Float64MultiArray

#: Reports that may wait: all parts of a process report on one connection at the same time.
_REPORTS = 1000


class Sender(Protocol):
    """A part that takes orders: a source or a ring."""

    def send(self, count: int, frequency: float, start: float, /) -> None:
        """Carry an order out."""


class Collected(Protocol):
    """A part that has something to report."""

    def collect(self) -> List[float]:
        """Return numbers and forget them."""


def listen_send(api: Any, control: str, sender: Sender) -> None:
    """Let ``sender`` send when it is told to; ``api`` is rospy or a NodeHandle."""

    def on_send(order: Float64MultiArray) -> None:
        count, frequency, start = order.data
        sender.send(int(count), frequency, start)

    api.Subscriber(control + "/send", Float64MultiArray, on_send, queue_size=10)


def listen_collect(api: Any, control: str, hop: int, part: Collected) -> None:
    """Let ``part`` report as ``hop``; ``api`` is rospy or a NodeHandle."""
    publisher = api.Publisher(control + "/report", Float64MultiArray, queue_size=_REPORTS)

    def on_collect(request: Empty) -> None:
        report = Float64MultiArray(data=part.collect())
        report.layout.data_offset = hop
        publisher.publish(report)

    api.Subscriber(control + "/collect", Empty, on_collect, queue_size=10)
