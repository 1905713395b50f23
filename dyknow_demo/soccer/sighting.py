# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""From a round outline in the image to the place of the ball: geometry and its uncertainty.

The outline of a sphere is where a circular cone, with its tip in the camera, meets the image. The
cone's axis points at the sphere's centre, which lies one radius above the floor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterable, Optional

import numpy as np

from dyknow_demo.soccer.finder import Find
from dyknow_demo.soccer.pinhole import Pinhole
from dyknow_demo.soccer.rigid import Array

#: Error (rad) of the camera's direction as its owner knows it, from mounting and encoders.
ANGLE_ERROR = math.radians(0.3)

#: How far (pixels of the planes) the centre of an outline may be off: standard deviation.
_CENTRE_ERROR = 0.25


@dataclass(frozen=True)
class Geometry:
    """Known quantities of camera and ball.

    Attributes:
        camera: intrinsics in full resolution.
        owner_from_camera: pose of the optical frame in its owner's frame, whose floor is z = 0.
        ball_radius: m.
        angle_error: standard deviation, rad, of the direction in which the camera looks.
        factor: of the planes in which outlines were found.
    """

    camera: Pinhole
    owner_from_camera: Array
    ball_radius: float
    angle_error: float
    factor: int


@dataclass(frozen=True)
class Sighting:
    """A ball in the frame of the camera's owner.

    Attributes:
        position: centre (3,), m.
        covariance: (3, 3), m^2.
        find: the round region that it was computed from.
    """

    position: Array
    covariance: Array
    find: Find


def best_sighting(finds: Iterable[Find], geometry: Geometry) -> Optional[Sighting]:
    """Pick the best find, in the order given, that can be a ball on the floor."""
    for find in finds:
        sighting = sight(find, geometry)
        if sighting is not None:
            return sighting
    return None


def sight(find: Find, geometry: Geometry) -> Optional[Sighting]:
    """Locate a ball; None if it is above the horizon or does not have a ball's size."""
    axis, angle = cone(geometry.camera.rays(find.outline))
    # The outline runs through the outermost pixels' centres.
    pixel = geometry.factor / geometry.camera.fx
    angle += 0.5 * pixel
    rotation, eye = geometry.owner_from_camera[:3, :3], geometry.owner_from_camera[:3, 3]
    ray = rotation @ axis
    height = eye[2] - geometry.ball_radius
    if ray[2] > -1e-3:
        return None
    distance = -height / ray[2]
    expected = np.arcsin(min(1.0, geometry.ball_radius / distance))
    if abs(angle - expected) > max(0.4 * expected, 1.5 * pixel):
        return None
    error = float(np.hypot(geometry.angle_error, _CENTRE_ERROR * pixel))
    return Sighting(eye + distance * ray, _covariance(ray, distance, error), find)


def cone(rays: Array) -> tuple[Array, float]:
    """Fit a circular cone to unit vectors (n, 3); return its axis and half its angle (rad).

    On a cone axis . ray = cos(angle), so (axis / cos(angle)) . ray = 1: linear least squares.
    """
    normal, *_ = np.linalg.lstsq(rays, np.ones(len(rays)), rcond=None)
    length = float(np.linalg.norm(normal))
    return normal / length, float(np.arccos(min(1.0, 1.0 / length)))


def _covariance(ray: Array, distance: float, error: float) -> Array:
    """Covariance of where a ray meets a level plane, given errors of its direction."""
    # A turn by w moves the ray by w x ray, and along the ray it goes on to the plane.
    turned = np.cross(np.eye(3), ray)
    moved = distance * (turned - np.outer(turned[:, 2] / ray[2], ray))
    covariance: Array = error**2 * moved.T @ moved
    return covariance
