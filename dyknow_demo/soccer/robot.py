# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How the NAO walks after the ball and looks at it; a function of time alone.

It aims at a place behind the mean position of the ball over the last seconds, which keeps it
slower than a NAO can walk, and its head follows the ball a little late.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import numpy as np

from dyknow_demo.soccer.ball import Ball
from dyknow_demo.soccer.nao import (
    BOTTOM_CAMERA_PITCH,
    HEAD_PITCH_LIMITS,
    HEAD_YAW_LIMITS,
    Posture,
)
from dyknow_demo.soccer.rigid import Array, apply, inverse, shift, turn

#: Seconds over which the robot averages the ball's position, and delay of its head in seconds.
_PATIENCE = 8.0
_LATENESS = 0.15

#: The robot stays this far behind the ball (m), and a little to its right.
_BEHIND = np.array([-1.1, -0.25])

#: The crouch of the gait: knee at rest, its swing (rad), steps a second.
_KNEE, _SWING, _STEPS = 0.70, 0.06, 1.8

#: Height of the camera over the ball when the robot stands (m).
_CAMERA_OVER_BALL = 0.43


@dataclass(frozen=True)
class RobotState:
    """Place on the field, x, y (m) and yaw (rad), and joint angles."""

    place: Tuple[float, float, float]
    posture: Posture

    @property
    def field_from_robot(self) -> Array:
        """Pose of the robot's frame on the field."""
        x, y, yaw = self.place
        return shift(x, y, 0.0) @ turn(0.0, 0.0, yaw)


def robot_at(ball: Ball, time: float) -> RobotState:
    """Compute the robot's place and posture."""
    past = time - np.linspace(0.0, _PATIENCE, 33)
    mean = ball.positions(past).mean(axis=0)
    place = mean + _BEHIND
    towards = np.array([0.6, 0.0]) + mean - place
    yaw = math.atan2(towards[1], towards[0])
    pose = shift(place[0], place[1], 0.0) @ turn(0.0, 0.0, yaw)
    seen = ball.positions(np.array(time - _LATENESS))
    x, y, _ = apply(inverse(pose), np.array([seen[0], seen[1], 0.0]))
    head_yaw = _clamp(math.atan2(y, x), HEAD_YAW_LIMITS)
    down = math.atan2(_CAMERA_OVER_BALL, math.hypot(x, y)) - BOTTOM_CAMERA_PITCH
    knee = _KNEE + _SWING * math.sin(2 * math.pi * _STEPS * (time % 3600.0))
    # The torso nods a little with each step: the hip does not fully compensate the knee.
    posture = Posture(head_yaw, _clamp(down, HEAD_PITCH_LIMITS), -0.45 * knee, knee, -0.5 * knee)
    return RobotState((float(place[0]), float(place[1]), yaw), posture)


def _clamp(value: float, limits: Tuple[float, float]) -> float:
    return min(max(value, limits[0]), limits[1])
