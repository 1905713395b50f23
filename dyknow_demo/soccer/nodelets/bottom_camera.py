# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow_demo/BottomCamera: the lower camera in the head of a simulated NAO."""

from __future__ import annotations

from dyknow_demo.soccer.nao import BOTTOM_CAMERA
from dyknow_demo.soccer.nodelets.simulated_camera import SimulatedCamera
from dyknow_demo.soccer.rigid import Array


class BottomCamera(SimulatedCamera):
    """Publishes the NAO's view of the floor before its feet, 640 x 480.

    Ports:
        image (out): sensor_msgs/Image, yuv422 (YUV 4:2:2 in the order UYVY).
        camera_info (out): sensor_msgs/CameraInfo, with each frame.

    Parameters:
        ~rate (double, 20): frames a second.
        ~seed (int, 0): of the simulated world.
        ~frame_id (string, the nodelet's name): of the optical frame.
    """

    def on_init(self) -> None:
        """Declare the ports and start the timer."""
        self.start(BOTTOM_CAMERA, 20.0)

    def pose(self, time: float) -> Array:
        """Pose of the camera as the robot walks and turns its head."""
        return self.world.field_from_bottom_camera(time)
