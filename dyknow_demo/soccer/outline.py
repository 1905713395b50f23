# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How round is an outline? Fits a circle or an ellipse, leaving out points that lie off it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Optional

import cv2
import numpy as np

from dyknow_demo.soccer.rigid import Array

_ROUNDS = 4
#: Points within this fraction of the radius, or this many pixels, count as on the curve.
_TOLERANCE, _PIXELS = 0.12, 0.75

#: Fewer points fit any ellipse.
_ENOUGH_FOR_ELLIPSE = 40


@dataclass(frozen=True)
class Ellipse:
    """An ellipse; a circle has equal axes.

    Attributes:
        centre: column and row.
        axes: half of the longer and of the shorter axis, pixels.
        angle: rad, of the longer axis.
    """

    centre: Array
    axes: tuple[float, float]
    angle: float

    @property
    def radius(self) -> float:
        """Radius of the circle of the same area."""
        return math.sqrt(self.axes[0] * self.axes[1])

    def ratios(self, points: Array) -> Array:
        """Distances of points (..., 2) from the centre, relative to the curve: 1 lies on it."""
        turned = (points - self.centre) @ np.array(
            [
                [math.cos(self.angle), -math.sin(self.angle)],
                [math.sin(self.angle), math.cos(self.angle)],
            ]
        )
        out: Array = np.hypot(turned[..., 0] / self.axes[0], turned[..., 1] / self.axes[1])
        return out


@dataclass(frozen=True)
class Fit:
    """A curve fitted to an outline.

    Attributes:
        curve: the curve.
        points: those of the outline (n, 2) that lie on it.
        agreement: their fraction of all points, 0 to 1.
    """

    curve: Ellipse
    points: Array
    agreement: float


def fit_round(points: Array, stretch: float = 1.0) -> Optional[Fit]:
    """Fit a circle to points (n, 2), or an ellipse if that agrees better.

    Args:
        points: some of them may belong to something else.
        stretch: the largest ratio of an ellipse's longer axis to its shorter one; 1 for circles
            only.

    Returns:
        The fit, or None if no such curve fits the points.
    """
    circle = _fit(points, _circle, 1.0)
    if stretch <= 1.0 or len(points) < _ENOUGH_FOR_ELLIPSE:
        return circle
    ellipse = _fit(points, _ellipse, stretch)
    if circle is None or (ellipse is not None and ellipse.agreement > circle.agreement):
        return ellipse
    return circle


def _fit(
    points: Array, curve_of: Callable[[Array], Optional[Ellipse]], stretch: float
) -> Optional[Fit]:
    on_it = np.ones(len(points), bool)
    curve: Optional[Ellipse] = None
    for _ in range(_ROUNDS):
        if on_it.sum() < 5:
            return None
        curve = curve_of(points[on_it])
        if curve is None:
            return None
        off = np.abs(curve.ratios(points) - 1.0)
        on_it = off <= max(_TOLERANCE, _PIXELS / curve.radius)
    if curve is None or curve.axes[0] > stretch * curve.axes[1]:
        return None
    return Fit(curve, points[on_it], float(on_it.mean()))


def _circle(points: Array) -> Optional[Ellipse]:
    """Kasa's fit: x^2 + y^2 = 2 a x + 2 b y + c is linear in a, b and c."""
    origin = points.mean(axis=0)
    near = points - origin
    system = np.column_stack((2 * near, np.ones(len(near))))
    (a, b, c), *_ = np.linalg.lstsq(system, (near**2).sum(axis=1), rcond=None)
    squared = float(c + a * a + b * b)
    if not 0.0 < squared < 1e8:
        return None
    radius = math.sqrt(squared)
    return Ellipse(origin + np.array([a, b]), (radius, radius), 0.0)


def _ellipse(points: Array) -> Optional[Ellipse]:
    (x, y), (width, height), degrees = cv2.fitEllipseDirect(points.astype(np.float32))
    if not (0.0 < width < 1e4 and 0.0 < height < 1e4):
        return None
    angle = math.radians(degrees) + (0.0 if width >= height else math.pi / 2)
    axes = max(width, height) / 2, min(width, height) / 2
    return Ellipse(np.array([x, y]), axes, angle)
