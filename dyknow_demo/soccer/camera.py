# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a camera over the field sees, as YUV 4:2:2."""

from __future__ import annotations

import cv2
import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer import field
from dyknow_demo.soccer.pinhole import Pinhole
from dyknow_demo.soccer.rigid import Array, apply, inverse
from dyknow_demo.soccer.sphere import draw_ball
from dyknow_demo.soccer.yuv import pack, yuv_from_bgr

#: BGR of the ball and of the lab's walls and floor.
ORANGE = (20, 105, 245)
_LAB = (120, 118, 112)

#: Standard deviation of the sensor's noise, in grey levels.
_NOISE = 3.0
#: The most pixels, either way, by which the noise pattern is shifted from frame to frame.
_SHIFTS = 256


class FieldCamera:
    """Renders frames of one camera; the field's picture and the noise are made once."""

    def __init__(self, camera: Pinhole, seed: int) -> None:
        """Make the picture of the field and the noise for these intrinsics."""
        self.camera = camera
        self._field = yuv_from_bgr(field.picture(seed))
        self._lab = _yuv(_LAB)
        self._ball = _yuv(ORANGE)
        self._generator = np.random.default_rng([seed, 3])
        shape = (camera.height + _SHIFTS, camera.width + _SHIFTS, 2)
        noise = self._generator.standard_normal(shape, np.float32)
        noise *= _NOISE
        steps = np.rint(noise, out=noise).astype(np.int8)
        self._brighter = np.maximum(steps, 0).view(np.uint8)
        self._darker = np.maximum(-steps, 0).view(np.uint8)
        self._still: tuple[bytes, Pixels] = (b"", self._field)

    def render(self, field_from_camera: Array, ball: Array, number: int, frame: Pixels) -> None:
        """Render one frame.

        Args:
            field_from_camera: pose of the optical frame on the field.
            ball: centre (3,) on the field, m.
            number: the frame's number; frames with the same number have the same noise.
            frame: (rows, columns, 2) of UYVY to write to.
        """
        camera_from_field = inverse(field_from_camera)
        picture = self._background(camera_from_field).copy()
        centre = apply(camera_from_field, ball)
        up = camera_from_field[:3, 2]
        draw_ball(picture, self.camera, centre, field.BALL_RADIUS, self._ball, up)
        pack(picture, frame)
        row, column = np.random.default_rng(number).integers(0, _SHIFTS, 2).tolist()
        window = np.s_[row : row + frame.shape[0], column : column + frame.shape[1]]
        cv2.add(frame, self._brighter[window], dst=frame)
        cv2.subtract(frame, self._darker[window], dst=frame)

    def _background(self, camera_from_field: Array) -> Pixels:
        """Field and lab without the ball; kept as long as the camera does not move."""
        key = camera_from_field.tobytes()
        if self._still[0] != key:
            self._still = key, self._warp(camera_from_field)
        return self._still[1]

    def _warp(self, camera_from_field: Array) -> Pixels:
        ground = self.camera.matrix @ camera_from_field[:3, (0, 1, 3)]
        map_ = ground @ np.linalg.inv(field.pixel_from_field())
        size = (self.camera.width, self.camera.height)
        warped: Pixels = cv2.warpPerspective(
            self._field,
            map_,
            size,
            flags=cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=self._lab,
        )
        above = self._above_horizon(camera_from_field)
        if above is not None:
            warped[above] = self._lab
        return warped

    def _above_horizon(self, camera_from_field: Array) -> Pixels | None:
        """Mask of the pixels above the horizon, if any: there the field would be mirrored."""
        up = camera_from_field[:3, 2]
        camera = self.camera
        columns = (np.arange(camera.width) - camera.cx) / camera.fx * up[0]
        rows = (np.arange(camera.height) - camera.cy) / camera.fy * up[1]
        if columns.max() + rows.max() + up[2] < 0:
            return None
        mask: Pixels = rows[:, None] + columns[None, :] + up[2] >= 0
        return mask


def _yuv(bgr: tuple[int, int, int]) -> tuple[int, int, int]:
    y, u, v = yuv_from_bgr(np.array([[bgr]], np.uint8))[0, 0].tolist()
    return y, u, v
