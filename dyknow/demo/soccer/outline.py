"""How round is an outline? A circle is fitted to it, and what does not lie on it put aside."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np

from dyknow.demo.soccer.rigid import Array

_ROUNDS = 4
#: Points within this part of the radius, or half a pixel, are taken to lie on the circle.
_TOLERANCE = 0.12


@dataclass(frozen=True)
class Circle:
    """A circle fitted to an outline.

    Attributes:
        centre: column and row.
        radius: pixels.
        points: those of the outline (n, 2) that lie on the circle.
        agreement: their part of all points, 0 to 1.
    """

    centre: Array
    radius: float
    points: Array
    agreement: float


def fit_circle(points: Array) -> Optional[Circle]:
    """Fit a circle to points (n, 2); some of them may belong to something else.

    Returns:
        The circle, or None if the points do not make one.
    """
    on_it = np.ones(len(points), bool)
    for _ in range(_ROUNDS):
        if on_it.sum() < 4:
            return None
        centre, radius = _least_squares(points[on_it])
        if not 0 < radius < 1e4:
            return None
        off = np.abs(np.hypot(*(points - centre).T) - radius)
        on_it = off <= max(_TOLERANCE * radius, 0.75)
    if on_it.sum() < 4:
        return None
    return Circle(centre, radius, points[on_it], float(on_it.mean()))


def _least_squares(points: Array) -> tuple[Array, float]:
    """Kasa's fit: x^2 + y^2 = 2 a x + 2 b y + c is linear in a, b and c."""
    origin = points.mean(axis=0)
    near = points - origin
    system = np.column_stack((2 * near, np.ones(len(near))))
    (a, b, c), *_ = np.linalg.lstsq(system, (near**2).sum(axis=1), rcond=None)
    centre: Array = origin + np.array([a, b])
    return centre, float(np.sqrt(max(c + a * a + b * b, 0.0)))
