# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow/Relay: the smallest useful nodelet with both kinds of ports."""

from __future__ import annotations

from typing import Any

import dyknow
from dyknow.ros.parameters import get_datatype


class Relay(dyknow.Nodelet):
    """Publishes the messages that it receives, by reference: none is copied.

    Ports:
        in: any type.
        out: the same type.

    Parameters:
        ~datatype (string, std_msgs/Header): ROS type of the messages.
    """

    def on_init(self) -> None:
        self.nh = dyknow.NodeHandle(self.node_handle)
        datatype = get_datatype(self.nh)
        self.pub = self.nh.Publisher("out", datatype, queue_size=100)
        self.sub = self.nh.Subscriber("in", datatype, self.on_message, queue_size=100)

    def on_message(self, message: Any) -> None:
        self.pub.publish(message)
