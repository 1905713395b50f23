# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The base of both simulated cameras."""

from __future__ import annotations

from typing import Any, Dict

from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

import dyknow
from dyknow.ros.parameters import get_positive
from dyknow_demo import images
from dyknow_demo.soccer.camera import FieldCamera
from dyknow_demo.soccer.pinhole import Pinhole
from dyknow_demo.soccer.rigid import Array
from dyknow_demo.soccer.world import World


class SimulatedCamera(dyknow.Nodelet):
    """Publishes a camera's current view of the world, with its intrinsics."""

    def start(self, camera: Pinhole, default_rate: float) -> None:
        """Declare the ports and start the timer."""
        self.nh = dyknow.NodeHandle(self.node_handle)
        seed = int(self.nh.get_param("~seed", 0))
        rate = get_positive(self.nh, "~rate", default_rate, "Hz")
        self.frame_id = str(self.nh.get_param("~frame_id", self.name.rpartition("/")[2]))
        self.world = World(seed)
        self.view = FieldCamera(camera, seed)
        self.intrinsics = _intrinsics(camera)
        self.count = 0
        self.image_pub = self.nh.Publisher("image", Image, queue_size=5)
        self.info_pub = self.nh.Publisher("camera_info", CameraInfo, queue_size=5)
        self.timer = self.nh.Timer(self.nh.Duration(1.0 / rate), self.on_timer)

    def pose(self, time: float) -> Array:
        """True pose of the optical frame on the field."""
        raise NotImplementedError

    def on_timer(self, event: Any) -> None:
        """Publish one frame."""
        stamp = self.nh.Time.now()
        header = Header(self.count, stamp, self.frame_id)
        self.publish_besides(header)
        self.info_pub.publish(CameraInfo(header=header, **self.intrinsics))
        time, camera = stamp.to_sec(), self.view.camera
        image = images.blank(header, camera.height, camera.width, "yuv422")
        ball = self.world.ball_on_field(time)
        self.view.render(self.pose(time), ball, self.count, images.array_of(image))
        self.image_pub.publish(image)
        self.count += 1

    def publish_besides(self, header: Any) -> None:
        """Publish anything else before a frame; nothing by default."""


def _intrinsics(camera: Pinhole) -> Dict[str, Any]:
    """Fields of CameraInfo, all but the header."""
    k = camera.matrix
    return {
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "plumb_bob",
        "D": [0.0] * 5,
        "K": k.ravel().tolist(),
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [*k[0], 0.0, *k[1], 0.0, *k[2], 0.0],
    }
