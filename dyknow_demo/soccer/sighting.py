# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""From a round outline in the image to the place of the ball: geometry and its uncertainty.

The outline of a sphere is where a circular cone, with its tip in the camera, meets the image. The
cone's axis points at the sphere's centre, which lies one radius above the floor.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from dataclasses import dataclass
from typing import Iterable, Sequence

import numpy as np

from dyknow_demo.soccer.finder import Find
from dyknow_demo.soccer.geometry import Array, Pinhole

#: Error (rad) of the camera's direction as its owner knows it, from mounting and encoders.
ANGLE_ERROR = math.radians(0.3)
#: How far (pixels of the planes) the centre of an outline may be off: standard deviation.
_CENTRE_ERROR = 0.25
#: Values of a signal that are kept, and seconds beyond them for which values are extrapolated.
_LENGTH, _REACH = 100, 0.1


@dataclass(frozen=True)
class Geometry:
    """Known quantities of camera and ball."""

    camera: Pinhole  # in full resolution
    owner_from_camera: Array  # pose of the optical frame in its owner's, whose floor is z = 0
    ball_radius: float  # m
    factor: int  # of the planes in which outlines were found
    angle_error: float = ANGLE_ERROR  # of the direction of the camera: standard deviation, rad


@dataclass(frozen=True)
class Sighting:
    """A ball in the frame of the camera's owner."""

    position: Array  # centre (3,), m
    covariance: Array  # (3, 3), m^2


def best_sighting(finds: Iterable[Find], geometry: Geometry) -> Sighting | None:
    """Locate the best find, in the order given, that can be a ball on the floor."""
    sightings = (sight(find, geometry) for find in finds)
    return next((each for each in sightings if each is not None), None)


def sight(find: Find, geometry: Geometry) -> Sighting | None:
    """Locate a ball; None if it is above the horizon or does not have a ball's size."""
    axis, angle = cone(geometry.camera.rays(find.outline))
    # The outline runs through the outermost pixels' centres.
    pixel = geometry.factor / geometry.camera.fx
    angle += 0.5 * pixel
    rotation, eye = geometry.owner_from_camera[:3, :3], geometry.owner_from_camera[:3, 3]
    ray = rotation @ axis
    if ray[2] > -1e-3:
        return None
    distance = (geometry.ball_radius - eye[2]) / ray[2]
    expected = np.arcsin(min(1.0, geometry.ball_radius / distance))
    if abs(angle - expected) > max(0.4 * expected, 1.5 * pixel):
        return None
    # A turn by w moves the ray by w x ray, and along the ray it goes on to the plane.
    turned = np.cross(np.eye(3), ray)
    moved = distance * (turned - np.outer(turned[:, 2] / ray[2], ray))
    error = float(np.hypot(geometry.angle_error, _CENTRE_ERROR * pixel))
    return Sighting(eye + distance * ray, error**2 * moved.T @ moved)


def cone(rays: Array) -> tuple[Array, float]:
    """Fit a circular cone to unit vectors (n, 3); return its axis and half its angle (rad).

    On a cone axis . ray = cos(angle), so (axis / cos(angle)) . ray = 1: linear least squares.
    """
    normal, *_ = np.linalg.lstsq(rays, np.ones(len(rays)), rcond=None)
    length = float(np.linalg.norm(normal))
    return normal / length, float(np.arccos(min(1.0, 1.0 / length)))


class History:
    """The last values of a signal by time, interpolated in between.

    An image is older or younger than the joint states that arrive with it. A head that turns at
    1 rad/s is 1 degree further after 20 ms, so the angles have to be those at the image's time.
    """

    def __init__(self, angular: Sequence[bool]) -> None:
        """Make an empty history; ``angular`` marks the components that are angles in rad."""
        self._angular = np.array(angular)
        self._times: deque[float] = deque(maxlen=_LENGTH)
        self._values: deque[Array] = deque(maxlen=_LENGTH)

    def add(self, time: float, values: Sequence[float]) -> None:
        """Add values; a time (s) that is not after the last one starts a new history."""
        if self._times and time <= self._times[-1]:
            self._times.clear()
            self._values.clear()
        self._times.append(time)
        self._values.append(np.array(values, np.float64))

    def at(self, time: float) -> tuple[float, ...] | None:
        """Interpolate linearly, or extrapolate a little; None further outside."""
        times = self._times
        if not times or not times[0] - _REACH <= time <= times[-1] + _REACH:
            return None
        if len(times) == 1:
            return tuple(self._values[0].tolist())
        after = min(max(bisect_left(times, time), 1), len(times) - 1)
        before = after - 1
        step = self._values[after] - self._values[before]
        short_way = np.remainder(step + math.pi, 2 * math.pi) - math.pi
        step = np.where(self._angular, short_way, step)
        part = (time - times[before]) / (times[after] - times[before])
        return tuple((self._values[before] + part * step).tolist())
