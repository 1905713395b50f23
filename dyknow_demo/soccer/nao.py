# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Pose of the NAO's bottom camera for given joint angles.

Dimensions of the NAO V4 and V5 in metres and radians, as documented by the manufacturer at
http://doc.aldebaran.com/1-14/family/nao_h25/links_h25.html (links), ``joints_h25.html`` beside it,
and http://doc.aldebaran.com/1-14/family/robots/video_robot.html (cameras; head 4.0, of which the
V5 has the same): angles of view 60.9 x 47.6 degrees, up to 1280 x 960 in YUV 4:2:2 at 30 Hz.

The robot's frame lies on the ground below its torso, x ahead, y left, z up (``base_footprint`` of
REP 120). The feet stand flat; sideways motion of the gait is left out.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, fields
from typing import Mapping, Tuple

from dyknow_demo.soccer.pinhole import Pinhole
from dyknow_demo.soccer.rigid import BODY_FROM_OPTICAL, Array, shift, turn

FOOT_HEIGHT = 0.04519
TIBIA_LENGTH = 0.10290
THIGH_LENGTH = 0.10000
HIP_OFFSET_Z = 0.08500
NECK_OFFSET_Z = 0.12650

#: The camera in the frame of the head; pitch is 39.7 degrees downwards.
BOTTOM_CAMERA_X, BOTTOM_CAMERA_Z, BOTTOM_CAMERA_PITCH = 0.05071, 0.01774, 0.6929

HEAD_YAW_LIMITS = (math.radians(-119.5), math.radians(119.5))
HEAD_PITCH_LIMITS = (math.radians(-38.5), math.radians(29.5))

#: Joints are read by magnetic encoders of 12 bits.
ENCODER_STEP = 2 * math.pi / 4096

BOTTOM_CAMERA = Pinhole.of_view(640, 480, math.radians(60.97), math.radians(47.64))


@dataclass(frozen=True)
class Posture:
    """The joints between the ground and the camera, in rad; both legs have the same angles."""

    head_yaw: float
    head_pitch: float
    hip_pitch: float
    knee_pitch: float
    ankle_pitch: float

    @classmethod
    def of_joints(cls, angles: Mapping[str, float]) -> Posture:
        """Pick the joints out of those of a robot, by NAOqi's names.

        Raises:
            KeyError: one of ``JOINT_NAMES`` is missing.
        """
        return cls(*(angles[name] for name in JOINT_NAMES))

    @property
    def angles(self) -> Tuple[float, ...]:
        """Angles in the order of ``JOINT_NAMES``."""
        return astuple(self)


#: NAOqi's names of the fields of ``Posture``.
JOINT_NAMES = ("HeadYaw", "HeadPitch", "LHipPitch", "LKneePitch", "LAnklePitch")
assert len(JOINT_NAMES) == len(fields(Posture))


def robot_from_torso(posture: Posture) -> Array:
    """Height and pitch of the torso, from the ground up along a leg."""
    shin = -posture.ankle_pitch
    thigh = shin - posture.knee_pitch
    torso = thigh - posture.hip_pitch
    height = (
        FOOT_HEIGHT
        + TIBIA_LENGTH * math.cos(shin)
        + THIGH_LENGTH * math.cos(thigh)
        + HIP_OFFSET_Z * math.cos(torso)
    )
    return shift(0.0, 0.0, height) @ turn(0.0, torso, 0.0)


def robot_from_bottom_camera(posture: Posture) -> Array:
    """Pose of the camera's optical frame in the robot's frame."""
    return (
        robot_from_torso(posture)
        @ shift(0.0, 0.0, NECK_OFFSET_Z)
        @ turn(0.0, posture.head_pitch, posture.head_yaw)
        @ shift(BOTTOM_CAMERA_X, 0.0, BOTTOM_CAMERA_Z)
        @ turn(0.0, BOTTOM_CAMERA_PITCH, 0.0)
        @ BODY_FROM_OPTICAL
    )
