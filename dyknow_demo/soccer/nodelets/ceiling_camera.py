# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow_demo/CeilingCamera: a simulated camera above the field."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped

from dyknow_demo.soccer.ceiling import CEILING_CAMERA, PLACE
from dyknow_demo.soccer.nodelets.places import place_message
from dyknow_demo.soccer.nodelets.simulated_camera import SimulatedCamera
from dyknow_demo.soccer.rigid import Array


class CeilingCamera(SimulatedCamera):
    """Publishes the view from the ceiling, 1280 x 960.

    Ports:
        image (out): sensor_msgs/Image, yuv422 (YUV 4:2:2 in the order UYVY).
        camera_info (out): sensor_msgs/CameraInfo, with each frame.
        pose (out): geometry_msgs/PoseWithCovarianceStamped, with each frame: place on the field of
            the camera's own frame, which is on the floor right below it.

    Parameters:
        ~rate (double, 15): frames a second.
        ~seed (int, 0): of the simulated world.
        ~frame_id (string, the nodelet's name): of the optical frame.
    """

    def on_init(self) -> None:
        """Declare the ports and start the timer."""
        self.start(CEILING_CAMERA, 15.0)
        self.pose_pub = self.nh.Publisher("pose", PoseWithCovarianceStamped, queue_size=5)

    def pose(self, time: float) -> Array:
        """Pose of the camera, which does not move."""
        return self.world.field_from_ceiling_camera()

    def publish_besides(self, header: Any) -> None:
        """Publish the place of the camera's frame."""
        self.pose_pub.publish(place_message(header.stamp, PLACE, 0.0, 0.0))
