# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The end of the re-wired chain."""

from __future__ import annotations

import json
from typing import Any

from sensor_msgs.msg import Image
from std_srvs.srv import Trigger, TriggerResponse

import dyknow
from dyknow_demo.accounting import FrameRecord


class Reporter(dyknow.Nodelet):
    """Records images, and hands its records out on request.

    Ports:
        image (in): sensor_msgs/Image; its ``frame_id`` names the camera.

    Services:
        ~arrivals (std_srvs/Trigger): all records since the load as JSON, a list of ``[frame_id,
            stamp in s, arrival in s, width, height]`` in the order of arrival.
    """

    def on_init(self) -> None:
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.arrivals: list[FrameRecord] = []
        self.sub = self.nh.Subscriber("image", Image, self.on_image, queue_size=100)
        self.service = self.nh.Service("~arrivals", Trigger, self.on_request)

    def on_image(self, image: Any) -> None:
        header, now = image.header, self.nh.get_time()
        size = image.width, image.height
        self.arrivals.append(FrameRecord(header.frame_id, header.stamp.to_sec(), now, *size))

    def on_request(self, request: Any) -> Any:
        return TriggerResponse(True, json.dumps(self.arrivals))
