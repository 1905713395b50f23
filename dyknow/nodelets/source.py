# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow/Source: something to listen to."""

from __future__ import annotations

from typing import Any

import dyknow
from dyknow.nodelets.stamps import stamp_field
from dyknow.ros.parameters import get_datatype, get_positive


class Source(dyknow.Nodelet):
    """Publishes messages at a steady rate.

    The messages are the type's defaults, stamped with the time of their publication where the
    type has a stamp. A header counts them: 0, 1, 2 … in ``seq`` and, as text, in ``frame_id``,
    since rospy writes its own ``seq`` where nodes of other processes listen.

    Ports:
        out: any type.

    Parameters:
        ~datatype (string, std_msgs/Header): ROS type of the messages.
        ~rate (double, 10): messages a second.
    """

    def on_init(self) -> None:
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.datatype = get_datatype(self.nh)
        self.owner, _, self.stamp = stamp_field(self.datatype).rpartition(".")
        self.count = 0
        rate = get_positive(self.nh, "~rate", 10.0, "Hz")
        self.pub = self.nh.Publisher("out", self.datatype, queue_size=100)
        self.timer = self.nh.Timer(self.nh.Duration(1.0 / rate), self.on_timer)

    def on_timer(self, event: Any) -> None:
        message = self.datatype()
        header = getattr(message, "header", message)
        if header._type == "std_msgs/Header":
            header.seq = self.count
            header.frame_id = str(self.count)
        if self.stamp:
            stamped = getattr(message, self.owner) if self.owner else message
            setattr(stamped, self.stamp, self.nh.Time.now())
        self.count += 1
        self.pub.publish(message)
