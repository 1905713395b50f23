# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow_demo/Reporter: keeps account of every camera frame that reaches it."""

from __future__ import annotations

import json
from typing import Any, Dict, List, Tuple

from sensor_msgs.msg import Image
from std_srvs.srv import Trigger, TriggerResponse

import dyknow
from dyknow.ros.parameters import get_positive
from dyknow_demo.rewiring.frame_names import FrameName

#: One image: its frame_id, when it was stamped, when it came (s, ROS time), width and height.
Arrival = Tuple[str, float, float, int, int]


class Reporter(dyknow.Nodelet):
    """Logs rate, latency, and frames lost and doubled; hands out its records on request.

    Frames between two of the same camera that never came are logged as lost, so a re-wiring to
    another camera and back shows as a gap: what was lost at a re-wiring only the records tell,
    compared with what was published.

    Ports:
        image (in): sensor_msgs/Image with ``camera#number`` as ``frame_id``.

    Parameters:
        ~period (double, 10): seconds from one line in the log to the next.

    Services:
        ~arrivals (std_srvs/Trigger): all records since the load as JSON, a list of ``[frame_id,
            stamp in s, arrival in s, width, height]`` in the order of arrival.
    """

    def on_init(self) -> None:
        """Declare the port, offer the service and start the timer."""
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.period = get_positive(self.nh, "~period", 10.0, "s")
        self.arrivals: List[Arrival] = []
        self.reported = 0
        self.latest: Dict[str, int] = {}
        self.lost = self.doubled = 0
        self.sub = self.nh.Subscriber("image", Image, self.on_image, queue_size=100)
        self.service = self.nh.Service("~arrivals", Trigger, self.on_request)
        self.timer = self.nh.Timer(self.nh.Duration(self.period), self.on_timer)

    def on_image(self, image: Any) -> None:
        """Record one image."""
        now = self.nh.get_time()
        header = image.header
        self.arrivals.append(
            (header.frame_id, header.stamp.to_sec(), now, image.width, image.height)
        )
        name = FrameName.parse(header.frame_id)
        last = self.latest.get(name.camera, name.number - 1)
        if name.number <= last:
            self.doubled += 1
        else:
            self.lost += name.number - last - 1
            self.latest[name.camera] = name.number

    def on_request(self, request: Any) -> Any:
        """Hand out the records."""
        return TriggerResponse(True, json.dumps(self.arrivals))

    def on_timer(self, event: Any) -> None:
        """Log what came since the last time, and what is missing since the start."""
        recent = self.arrivals[self.reported :]
        self.reported = len(self.arrivals)
        line = f"{len(recent)} images, {len(recent) / self.period:.1f} Hz"
        if recent:
            mean = sum(arrived - sent for _, sent, arrived, _, _ in recent) / len(recent)
            line += f", latency {1000 * mean:.2f} ms on average"
        self.nh.loginfo(
            "%s: %s; since the start %d lost, %d doubled",
            self.name,
            line,
            self.lost,
            self.doubled,
        )
