# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The pinhole camera: between points in its optical frame and pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Sequence

import numpy as np

from dyknow_demo.soccer.rigid import Array


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics without distortion; (0, 0) is the centre of the upper left pixel.

    Attributes:
        width: pixels.
        height: pixels.
        fx: focal length in pixels, horizontally.
        fy: focal length in pixels, vertically.
        cx: column of the optical axis.
        cy: row of the optical axis.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def of_view(cls, width: int, height: int, horizontal: float, vertical: float) -> Pinhole:
        """Make the intrinsics of a camera from its angles of view in rad."""
        return cls(
            width,
            height,
            width / 2 / math.tan(horizontal / 2),
            height / 2 / math.tan(vertical / 2),
            (width - 1) / 2,
            (height - 1) / 2,
        )

    @classmethod
    def of_matrix(cls, width: int, height: int, k: Sequence[float]) -> Pinhole:
        """Read the nine numbers of sensor_msgs/CameraInfo's K."""
        return cls(width, height, k[0], k[4], k[2], k[5])

    @property
    def matrix(self) -> Array:
        """The 3 x 3 matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: Array) -> Array:
        """Pixels (..., 2) of points (..., 3) in front of the camera."""
        x = self.fx * points[..., 0] / points[..., 2] + self.cx
        y = self.fy * points[..., 1] / points[..., 2] + self.cy
        return np.stack((x, y), axis=-1)

    def rays(self, pixels: Array) -> Array:
        """Unit vectors (..., 3) of the viewing directions of pixels (..., 2)."""
        x = (pixels[..., 0] - self.cx) / self.fx
        y = (pixels[..., 1] - self.cy) / self.fy
        directions = np.stack((x, y, np.ones_like(x)), axis=-1)
        unit: Array = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
        return unit
