# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The simulated truth: a function of one seed and the time.

The same seed gives the same world, so each nodelet can simulate its own part of it in any process.
The robot's software has slightly wrong data, as in reality: each camera's mounting and the robot's
estimate of its own place have errors, which also depend on the seed.
"""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

from dyknow_demo.soccer import ceiling
from dyknow_demo.soccer.ball import INTERVAL, KICKS, Ball
from dyknow_demo.soccer.field import BALL_RADIUS
from dyknow_demo.soccer.nao import ENCODER_STEP, Posture, robot_from_bottom_camera
from dyknow_demo.soccer.rigid import Array, apply, inverse, shift, turn
from dyknow_demo.soccer.robot import RobotState, robot_at

#: Standard deviations: a camera's mounting about each axis after calibration, the robot's
#: self-localization on the field, and the time after which its errors are new.
MOUNTING_ERROR = math.radians(0.2)
PLACE_ERROR = 0.03  # m
HEADING_ERROR = math.radians(0.7)
_FORGETS = 4.0  # s


class World:
    """A ball, a NAO and a camera on the ceiling, with their true states."""

    def __init__(self, seed: int = 0) -> None:
        """Generate the world's errors and paths from a seed."""
        self.seed = seed
        self.ball = Ball(seed)
        generator = np.random.default_rng([seed, 2])
        errors = generator.normal(0.0, MOUNTING_ERROR, (2, 3))
        self._bottom_error, self._ceiling_error = (turn(*each) for each in errors)
        knots = round(KICKS * INTERVAL / _FORGETS)
        self._place_errors: Array = generator.normal(
            0.0, (PLACE_ERROR, PLACE_ERROR, HEADING_ERROR), (knots, 3)
        )

    def ball_on_field(self, time: float) -> Array:
        """Centre (3,) of the ball in the field's frame."""
        x, y = self.ball.positions(np.array(time))
        return np.array([x, y, BALL_RADIUS])

    def ball_from_robot(self, time: float) -> Array:
        """Centre (3,) of the ball in the robot's frame."""
        return apply(inverse(self.robot(time).field_from_robot), self.ball_on_field(time))

    def robot(self, time: float) -> RobotState:
        """The robot's true place and posture."""
        return robot_at(self.ball, time)

    def encoders(self, time: float) -> Posture:
        """The posture as the robot's encoders read it."""
        angles = self.robot(time).posture.angles
        return Posture(*(round(each / ENCODER_STEP) * ENCODER_STEP for each in angles))

    def believed_place(self, time: float) -> Tuple[float, float, float]:
        """The robot's place as estimated by its self-localization: x, y (m), yaw (rad)."""
        knots = len(self._place_errors)
        count = time / _FORGETS
        before = math.floor(count)
        part = (1 - math.cos(math.pi * (count - before))) / 2
        here, there = (self._place_errors[(before + step) % knots] for step in (0, 1))
        error = (1 - part) * here + part * there
        x, y, yaw = (float(each) for each in np.asarray(self.robot(time).place) + error)
        return x, y, yaw

    def field_from_bottom_camera(self, time: float) -> Array:
        """True pose of the bottom camera's optical frame on the field."""
        robot = self.robot(time)
        mounted = robot_from_bottom_camera(robot.posture) @ self._bottom_error
        return robot.field_from_robot @ mounted

    def field_from_ceiling_camera(self) -> Array:
        """True pose of the ceiling camera's optical frame on the field."""
        x, y, yaw = ceiling.PLACE
        mounted = ceiling.floor_from_camera(ceiling.HEIGHT, math.pi / 2) @ self._ceiling_error
        return shift(x, y, 0.0) @ turn(0.0, 0.0, yaw) @ mounted
