# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Rigid transformations, the pinhole camera, and how the cameras of the study are mounted.

``a_from_b`` is a 4 x 4 matrix that takes points of frame b to frame a. Metres and radians. The
owner of a camera, a robot or the camera itself, has a frame on the floor: x ahead, y left, z up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Callable, NamedTuple, Sequence

import numpy as np

if TYPE_CHECKING:
    import numpy.typing

    Array = numpy.typing.NDArray[np.float64]
else:
    Array = np.ndarray  # the numpy of Ubuntu 20.04 has no numpy.typing

#: From a camera's optical frame (z ahead, x right, y down; REP 103) to one with x ahead, z up.
_BODY_FROM_OPTICAL: Array = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def shift(x: float, y: float, z: float) -> Array:
    matrix: Array = np.eye(4)
    matrix[:3, 3] = (x, y, z)
    return matrix


def turn(roll: float, pitch: float, yaw: float) -> Array:
    """Rotate about fixed x, then y, then z."""
    matrix: Array = np.eye(4)
    for axis, angle in enumerate((roll, pitch, yaw)):
        step = np.eye(4)
        one, other = (axis + 1) % 3, (axis + 2) % 3
        step[one, one] = step[other, other] = math.cos(angle)
        step[other, one] = math.sin(angle)
        step[one, other] = -math.sin(angle)
        matrix = step @ matrix
    return matrix


def inverse(matrix: Array) -> Array:
    result: Array = np.eye(4)
    result[:3, :3] = matrix[:3, :3].T
    result[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return result


def apply(matrix: Array, points: Array) -> Array:
    """Transform points of shape (..., 3)."""
    moved: Array = points @ matrix[:3, :3].T + matrix[:3, 3]
    return moved


def field_from_owner(place: Sequence[float]) -> Array:
    """Pose of an owner's frame at a place on the field: x, y, yaw."""
    x, y, yaw = place
    return shift(x, y, 0.0) @ turn(0.0, 0.0, yaw)


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics in pixels, without distortion; (0, 0) is the centre of the upper left pixel."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def of_view(cls, width: int, height: int, horizontal: float, vertical: float) -> Pinhole:
        """Make the intrinsics of a camera from its angles of view in rad."""
        fx, fy = width / 2 / math.tan(horizontal / 2), height / 2 / math.tan(vertical / 2)
        return cls(width, height, fx, fy, (width - 1) / 2, (height - 1) / 2)

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
        pixels: Array = points[..., :2] / points[..., 2:]
        return pixels * (self.fx, self.fy) + (self.cx, self.cy)

    def rays(self, pixels: Array) -> Array:
        """Unit vectors (..., 3) of the viewing directions of pixels (..., 2)."""
        flat = (pixels - (self.cx, self.cy)) / (self.fx, self.fy)
        directions = np.concatenate((flat, np.ones_like(flat[..., :1])), axis=-1)
        unit: Array = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
        return unit


# The NAO V4 and V5, as documented at http://doc.aldebaran.com/1-14/family/nao_h25/links_h25.html
# (links; the joints are beside it) and .../family/robots/video_robot.html (cameras; head 4.0).
_FOOT_HEIGHT, _TIBIA, _THIGH = 0.04519, 0.10290, 0.10000
_HIP_OFFSET_Z, _NECK_OFFSET_Z = 0.08500, 0.12650
_CAMERA_X, _CAMERA_Z = 0.05071, 0.01774  # from the head's joint
BOTTOM_CAMERA_PITCH = 0.6929  # 39.7 degrees downwards
HEAD_YAW_LIMITS = (math.radians(-119.5), math.radians(119.5))
HEAD_PITCH_LIMITS = (math.radians(-38.5), math.radians(29.5))
#: Joints are read by magnetic encoders of 12 bits.
ENCODER_STEP = 2 * math.pi / 4096
BOTTOM_CAMERA = Pinhole.of_view(640, 480, math.radians(60.97), math.radians(47.64))

#: NAOqi's names of the joints between the ground and the camera; both legs have the same angles.
JOINTS = ("HeadYaw", "HeadPitch", "LHipPitch", "LKneePitch", "LAnklePitch")


def robot_from_bottom_camera(angles: Sequence[float]) -> Array:
    """Pose of the NAO's bottom camera for the angles of ``JOINTS``; the feet stand flat."""
    head_yaw, head_pitch, hip, knee, ankle = angles
    shin, thigh = -ankle, -ankle - knee
    torso = thigh - hip
    legs = _FOOT_HEIGHT + _TIBIA * math.cos(shin) + _THIGH * math.cos(thigh)
    return (
        shift(0.0, 0.0, legs + _HIP_OFFSET_Z * math.cos(torso))
        @ turn(0.0, torso, 0.0)
        @ shift(0.0, 0.0, _NECK_OFFSET_Z)
        @ turn(0.0, head_pitch, head_yaw)
        @ shift(_CAMERA_X, 0.0, _CAMERA_Z)
        @ turn(0.0, BOTTOM_CAMERA_PITCH, 0.0)
        @ _BODY_FROM_OPTICAL
    )


#: The camera above the middle of the field, which sees the field of 9 m x 6 m and its border.
CEILING_CAMERA = Pinhole.of_view(1280, 960, math.radians(78.0), math.radians(62.5))
CEILING_HEIGHT = 6.5
CEILING_PLACE = (0.0, 0.0, math.pi / 2)


def floor_from_camera(height: float, pitch: float, roll: float = 0.0) -> Array:
    """Pose of a fixed camera in its own frame, on the floor below it.

    Args:
        height: above the floor.
        pitch: from the horizontal downwards; at pi/2 the top of the picture is ahead.
        roll: about the line of sight.
    """
    return shift(0.0, 0.0, height) @ turn(roll, pitch, 0.0) @ _BODY_FROM_OPTICAL


class Mount(NamedTuple):
    """How a camera is mounted: the joints that move it, and its pose for their angles."""

    joints: tuple[str, ...]
    owner_from_camera: Callable[[Sequence[float]], Array]


#: The form that ``mount_of`` accepts, for error messages.
MOUNT = "nao_bottom, or the numbers height (m, above 0), pitch and, optionally, roll (rad)"


def mount_of(given: Any) -> Mount:
    """Make a mount of ``"nao_bottom"``, or of height, pitch and perhaps roll; else ValueError."""
    if given == "nao_bottom":
        return Mount(JOINTS, robot_from_bottom_camera)
    needed = {"height", "pitch"}
    if isinstance(given, dict) and needed <= set(given) <= needed | {"roll"}:
        values = {name: float(value) for name, value in given.items()}
        if values["height"] > 0:
            pose = floor_from_camera(**values)
            return Mount((), lambda angles: pose)
    raise ValueError(f"expected {MOUNT}")
