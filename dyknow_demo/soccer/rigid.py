# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Rigid transformations as 4 x 4 matrices; metres and radians.

``a_from_b`` takes points of frame b to frame a; ``a_from_b @ b_from_c`` is ``a_from_c``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Tuple

import numpy as np

if TYPE_CHECKING:
    import numpy.typing

    Array = numpy.typing.NDArray[np.float64]
else:
    Array = np.ndarray  # the numpy of Ubuntu 20.04 has no numpy.typing

#: From a camera's optical frame (z ahead, x right, y down; REP 103) to one with x ahead, z up.
BODY_FROM_OPTICAL: Array = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def shift(x: float, y: float, z: float) -> Array:
    """Translate."""
    matrix: Array = np.eye(4)
    matrix[:3, 3] = (x, y, z)
    return matrix


def turn(roll: float, pitch: float, yaw: float) -> Array:
    """Rotate about fixed x, then y, then z: rotZ(yaw) rotY(pitch) rotX(roll)."""
    (cr, sr), (cp, sp), (cy, sy) = (
        (math.cos(angle), math.sin(angle)) for angle in (roll, pitch, yaw)
    )
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, 0.0],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, 0.0],
            [-sp, cp * sr, cp * cr, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def inverse(matrix: Array) -> Array:
    """Invert a rigid transformation."""
    result: Array = np.eye(4)
    result[:3, :3] = matrix[:3, :3].T
    result[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return result


def apply(matrix: Array, points: Array) -> Array:
    """Transform points of shape (..., 3)."""
    moved: Array = points @ matrix[:3, :3].T + matrix[:3, 3]
    return moved


def quaternion_of_yaw(yaw: float) -> Tuple[float, float, float, float]:
    """Quaternion (x, y, z, w) of a rotation about z."""
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


def yaw_of_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Angle about z of a quaternion, the last rotation of three about x, y and z."""
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
