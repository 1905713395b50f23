# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow/Throttle: fewer messages of the same stream."""

from __future__ import annotations

from typing import Any

import dyknow
from dyknow.ros.parameters import get_datatype, get_positive


class Throttle(dyknow.Nodelet):
    """Publishes the messages that it receives, at most at a given rate; drops the rest.

    Ports:
        in: any type.
        out: the same type.

    Parameters:
        ~datatype (string, std_msgs/Header): ROS type of the messages.
        ~rate (double, 1): messages a second at most.
    """

    def on_init(self) -> None:
        self.nh = dyknow.NodeHandle(self.node_handle)
        datatype = get_datatype(self.nh)
        self.period = 1.0 / get_positive(self.nh, "~rate", 1.0, "Hz")
        self.due = 0.0
        self.pub = self.nh.Publisher("out", datatype, queue_size=100)
        self.sub = self.nh.Subscriber("in", datatype, self.on_message, queue_size=100)

    def on_message(self, message: Any) -> None:
        """Hand a message on if it is time for one."""
        now = self.nh.get_time()
        if self.due - self.period <= now < self.due:
            return
        # Counting from when it was due keeps the rate where messages come a little late. After a
        # pause, or when simulated time was set back, counting begins again.
        in_step = self.due <= now < self.due + self.period
        self.due = (self.due if in_step else now) + self.period
        self.pub.publish(message)
