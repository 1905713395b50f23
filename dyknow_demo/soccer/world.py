# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The simulated truth: a function of one seed and the time.

The same seed gives the same world, so each nodelet can simulate its own part of it in any process.
The robot's software has slightly wrong data, as in reality: each camera's mounting and the robot's
estimate of its own place have errors, which also depend on the seed.

The field is that of the RoboCup Standard Platform League, by the rule book of 2015, the last year
of the orange ball (http://spl.robocup.org). Its frame has its origin in the middle, x along the
longer side, y to the left, z up.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dyknow_demo.soccer import geometry
from dyknow_demo.soccer.geometry import Array

FIELD_LENGTH, FIELD_WIDTH = 9.0, 6.0
BALL_RADIUS = 0.0325

#: Kicks of the ball in a round, seconds from one to the next, and for how many of them it rolls.
KICKS, INTERVAL, ROLLING = 24, 4.0, 3.0
#: Half axes (m) of the loop along which it is kicked, and how far the places lie off it.
_LOOP, _SPREAD = (2.6, 1.6), 0.15

#: The robot averages the ball's position over seconds; its head is late by seconds.
_PATIENCE, _LATENESS = 8.0, 0.15
#: It stays this far behind the ball (m), and a little to its right.
_BEHIND = np.array([-1.1, -0.25])
#: The crouch of the gait: knee at rest, its swing (rad), steps a second.
_KNEE, _SWING, _STEPS = 0.70, 0.06, 1.8
_CAMERA_OVER_BALL = 0.43  # height of the camera over the ball when the robot stands (m)

#: Standard deviations: a camera's mounting about each axis after calibration, the robot's
#: self-localization on the field, and the time after which its errors are new.
MOUNTING_ERROR = math.radians(0.2)
PLACE_ERROR = 0.03  # m
HEADING_ERROR = math.radians(0.7)
_FORGETS = 4.0  # s


class RobotState(NamedTuple):
    """Place on the field, x, y (m) and yaw (rad), and angles (rad) of ``geometry.JOINTS``."""

    place: tuple[float, float, float]
    angles: tuple[float, ...]


class SoccerWorld:
    """A ball, a NAO and a camera on the ceiling, with their true states."""

    def __init__(self, seed: int = 0) -> None:
        """Draw the places from which the ball is kicked, and the world's errors."""
        angles = 2 * math.pi * np.arange(KICKS) / KICKS
        loop = np.stack((_LOOP[0] * np.cos(angles), _LOOP[1] * np.sin(angles)), axis=1)
        generator = np.random.default_rng([seed, 1])
        self._kicks: Array = loop + generator.uniform(-_SPREAD, _SPREAD, loop.shape)
        generator = np.random.default_rng([seed, 2])
        errors = generator.normal(0.0, MOUNTING_ERROR, (2, 3))
        self._bottom_error, self._ceiling_error = (geometry.turn(*each) for each in errors)
        spread = (PLACE_ERROR, PLACE_ERROR, HEADING_ERROR)
        self._place_errors = generator.normal(0.0, spread, (round(KICKS * INTERVAL / _FORGETS), 3))

    def ball_on_field(self, times: float | Array) -> Array:
        """Centres (..., 3) of the ball on the field at times (...) in seconds.

        It slows down evenly after each kick; a round takes ``KICKS * INTERVAL`` seconds.
        """
        kicks = np.floor(np.asarray(times) / INTERVAL)
        passed = np.minimum((times - kicks * INTERVAL) / ROLLING, 1.0)
        number = kicks.astype(np.int64)
        start, end = self._kicks[number % KICKS], self._kicks[(number + 1) % KICKS]
        flat = start + (1.0 - (1.0 - passed) ** 2)[..., None] * (end - start)
        centre: Array = np.concatenate((flat, np.full_like(flat[..., :1], BALL_RADIUS)), axis=-1)
        return centre

    def robot(self, time: float) -> RobotState:
        """The robot's true state: it walks slowly after the ball, and its head follows it."""
        mean = self.ball_on_field(time - np.linspace(0.0, _PATIENCE, 33)).mean(axis=0)[:2]
        x, y = (mean + _BEHIND).tolist()
        towards = np.array([0.6, 0.0]) - _BEHIND
        place = x, y, math.atan2(towards[1], towards[0])
        seen = self.ball_on_field(time - _LATENESS)
        ahead, left, _ = geometry.apply(geometry.inverse(geometry.field_from_owner(place)), seen)
        down = (
            math.atan2(_CAMERA_OVER_BALL, math.hypot(ahead, left)) - geometry.BOTTOM_CAMERA_PITCH
        )
        head_yaw = float(np.clip(math.atan2(left, ahead), *geometry.HEAD_YAW_LIMITS))
        knee = _KNEE + _SWING * math.sin(2 * math.pi * _STEPS * (time % 3600.0))
        # The torso nods a little with each step: the hip does not fully compensate the knee.
        head_pitch = float(np.clip(down, *geometry.HEAD_PITCH_LIMITS))
        return RobotState(place, (head_yaw, head_pitch, -0.45 * knee, knee, -0.5 * knee))

    def encoders(self, time: float) -> tuple[float, ...]:
        """The angles as the robot's encoders read them."""
        return tuple(
            round(each / geometry.ENCODER_STEP) * geometry.ENCODER_STEP
            for each in self.robot(time).angles
        )

    def believed_place(self, time: float) -> tuple[float, float, float]:
        """The robot's place as estimated by its self-localization: x, y (m), yaw (rad)."""
        count = time / _FORGETS
        before = math.floor(count)
        part = (1 - math.cos(math.pi * (count - before))) / 2
        knots = len(self._place_errors)
        here, there = (self._place_errors[(before + step) % knots] for step in (0, 1))
        error = (1 - part) * here + part * there
        x, y, yaw = (np.asarray(self.robot(time).place) + error).tolist()
        return x, y, yaw

    def field_from_bottom_camera(self, time: float) -> Array:
        """True pose of the bottom camera's optical frame on the field."""
        robot = self.robot(time)
        mounted = geometry.robot_from_bottom_camera(robot.angles) @ self._bottom_error
        return geometry.field_from_owner(robot.place) @ mounted

    def field_from_ceiling_camera(self) -> Array:
        """True pose of the ceiling camera's optical frame on the field."""
        mounted = (
            geometry.floor_from_camera(geometry.CEILING_HEIGHT, math.pi / 2) @ self._ceiling_error
        )
        return geometry.field_from_owner(geometry.CEILING_PLACE) @ mounted
