# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow/Sink: the rate and the latency of messages."""

from __future__ import annotations

from operator import attrgetter
from typing import Any

import dyknow
from dyknow.nodelets.stamps import stamp_field
from dyknow.ros.parameters import get_datatype, get_positive


class Sink(dyknow.Nodelet):
    """Logs the rate of the messages that it receives and, if they are stamped, their latency.

    Ports:
        in: any type.

    Parameters:
        ~datatype (string, std_msgs/Header): ROS type of the messages.
        ~period (double, 5): seconds from one line in the log to the next.
    """

    def on_init(self) -> None:
        self.nh = dyknow.NodeHandle(self.node_handle)
        datatype = get_datatype(self.nh)
        field = stamp_field(datatype)
        self.stamp_of = attrgetter(field) if field else None
        self.period = get_positive(self.nh, "~period", 5.0, "s")
        self.count = 0
        self.latencies: list[float] = []
        self.sub = self.nh.Subscriber("in", datatype, self.on_message, queue_size=100)
        self.timer = self.nh.Timer(self.nh.Duration(self.period), self.on_timer)

    def on_message(self, message: Any) -> None:
        """Count a message; its latency is that from its stamp to now, in s."""
        self.count += 1
        stamp = self.stamp_of(message) if self.stamp_of is not None else None
        if stamp:
            self.latencies.append(self.nh.get_time() - stamp.to_sec())

    def on_timer(self, event: Any) -> None:
        """Log the messages since the last time."""
        line = f"{self.count} messages, {self.count / self.period:.1f} Hz"
        if self.latencies:
            mean = 1000 * sum(self.latencies) / len(self.latencies)
            worst = 1000 * max(self.latencies)
            line += f", latency {mean:.3f} ms on average, {worst:.3f} ms at most"
        self.nh.loginfo("%s: %s", self.name, line)
        self.count = 0
        self.latencies = []
