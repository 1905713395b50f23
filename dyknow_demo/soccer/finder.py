# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Finds round things of one colour in an image, coarse to fine.

The whole image is searched in the coarsest planes only, with wide limits of the colour. Around
each region found there, finer planes are searched for a region with a round outline: a circle, or
an ellipse, is fitted to it, and points that lie off the curve are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Callable, Iterator, List, Mapping, NamedTuple, Optional, Tuple

import cv2
import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer.geometry import Array

Box = Tuple[float, float, float, float]


class Colour(NamedTuple):
    """Lowest and highest values, both inclusive, of Y, U and V."""

    y: Tuple[int, int]
    u: Tuple[int, int]
    v: Tuple[int, int]

    def mask(self, planes: Pixels, slack: int = 0) -> Pixels:
        """Mark (255) the pixels of planes that have the colour, or U and V a little beside it."""
        lower = (self.y[0], self.u[0] - slack, self.v[0] - slack)
        upper = (self.y[1], self.u[1] + slack, self.v[1] + slack)
        y, u, v = (cv2.inRange(*each) for each in zip(planes, lower, upper))
        return np.asarray(cv2.bitwise_and(cv2.bitwise_and(y, u, dst=y), v, dst=y))


#: The ball of the Standard Platform League until 2015, and those of the Middle Size League.
ORANGE = Colour((30, 235), (0, 112), (152, 255))
YELLOW = Colour((40, 235), (0, 102), (120, 155))
COLOURS = {"orange": ORANGE, "yellow": YELLOW}

#: Grey levels by which colours may be off in the coarse planes, whose pixels mix, and how many of
#: the largest regions there are examined.
_SLACK, _REGIONS = 8, 16
_ROUNDS = 4
#: Points within this fraction of the radius, or this many pixels, count as on the curve.
_TOLERANCE, _PIXELS = 0.12, 0.75
#: Fewer points fit any ellipse.
_ENOUGH_FOR_ELLIPSE = 40


class Limits(NamedTuple):
    """What counts as a ball.

    Attributes:
        area: least number of pixels of a region in the fine planes.
        roundness: least score, see ``Find``.
        size: largest radius as a fraction of the image's width.
        stretch: the most that an outline may be longer than wide; lenses that distort need > 1.
    """

    area: int = 6
    roundness: float = 0.5
    size: float = 0.2
    stretch: float = 1.0


_LIMITS = Limits()


@dataclass(frozen=True)
class Find:
    """A round region; columns and rows are those of the image in full resolution.

    Attributes:
        centre: of the fitted curve, (column, row).
        radius: pixels.
        box: left, top, right, bottom of the region itself.
        outline: points (n, 2) of the outline that lie on the curve.
        score: 0 to 1: the fraction of the outline on the curve, times the fraction of the inside
            that is filled; or what the forest says.
    """

    centre: Tuple[float, float]
    radius: float
    box: Box
    outline: Array
    score: float


def find_balls(
    pyramid: Mapping[int, Pixels], colour: Colour, limits: Limits = _LIMITS
) -> List[Find]:
    """Find round regions of a colour, the best first.

    Args:
        pyramid: planes by their factor; balls are searched for at the largest factor and confirmed
            at the smallest one.
        colour: of the ball.
        limits: what counts as a ball.
    """
    coarse, fine = max(pyramid), min(pyramid)
    _, rows, columns = pyramid[fine].shape
    found: List[Find] = []
    for window in _windows(colour.mask(pyramid[coarse], _SLACK)):
        left, top, right, bottom = (coarse // fine * each for each in window)
        left, top, right, bottom = (
            max(left, 0),
            max(top, 0),
            min(right, columns),
            min(bottom, rows),
        )
        for outline in outlines_in(
            colour.mask(pyramid[fine][:, top:bottom, left:right]), (left, top)
        ):
            find = _find(outline, (columns, rows), fine, limits)
            if find is not None:
                found.append(find)
    found.sort(key=lambda find: (-find.score, find.centre))
    unique: List[Find] = []
    for each in found:
        if not any(
            math.dist(each.centre, other.centre) <= max(each.radius, other.radius)
            for other in unique
        ):
            unique.append(each)
    return unique


def outlines_in(mask: Pixels, offset: Tuple[int, int] = (0, 0)) -> List[Any]:
    """Outlines of the connected regions of a mask, (n, 1, 2)."""
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE, offset=offset)
    return list(found)


def area_of(outline: Any) -> float:
    """Pixels of a region: its outline runs through the centres of the outermost ones."""
    return float(cv2.contourArea(outline) + len(outline) / 2 + 1)


def make_find(outline: Any, fit: Fit, factor: int, score: float) -> Find:
    """Make a find of a curve that fits an outline in planes."""
    left, top, width, height = (factor * each for each in cv2.boundingRect(outline))
    column, row = full_resolution(fit.centre, factor).tolist()
    radius, points = (fit.radius + 0.5) * factor, full_resolution(fit.points, factor)
    return Find((column, row), radius, (left, top, left + width, top + height), points, score)


def full_resolution(pixels: Array, factor: int) -> Array:
    """Columns and rows in full resolution."""
    return (pixels + 0.5) * factor - 0.5


def _windows(mask: Pixels) -> Iterator[Tuple[int, int, int, int]]:
    """Left, top, right, bottom of the largest regions of a mask, with a margin."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    regions = stats[1:]
    order = np.lexsort((regions[:, 0], regions[:, 1], -regions[:, cv2.CC_STAT_AREA]))
    for left, top, width, height, _ in regions[order[:_REGIONS]].tolist():
        margin = 2 + max(width, height) // 4
        yield left - margin, top - margin, left + width + margin, top + height + margin


def _find(outline: Any, size: Tuple[int, int], factor: int, limits: Limits) -> Optional[Find]:
    area = area_of(outline)
    if area < limits.area:
        return None
    fit = fit_round(inner_points(outline, size), limits.stretch)
    if fit is None or fit.radius + 0.5 > limits.size * size[0]:
        return None
    score = fit.agreement * min(1.0, area / _visible(fit, size))
    return make_find(outline, fit, factor, score) if score >= limits.roundness else None


def inner_points(outline: Any, size: Tuple[int, int]) -> Array:
    """Points (n, 2) of an outline, but not those on the border of the image."""
    points = outline.reshape(-1, 2).astype(np.float64)
    inner: Array = points[np.all((points > 0) & (points < np.array(size) - 1), axis=1)]
    return inner


def _visible(fit: Fit, size: Tuple[int, int]) -> float:
    """Area of the part of a curve's inside that lies in the image."""
    reach = fit.axes[0] + 0.5
    columns, rows = (
        np.arange(max(0, int(middle - reach)), min(count, int(middle + reach) + 2), dtype=float)
        for middle, count in zip(fit.centre, size)
    )
    grid = np.stack(np.meshgrid(columns, rows), axis=-1)
    return max(float((fit.ratios(grid) <= 1.0 + 0.5 / fit.radius).sum()), 1.0)


@dataclass(frozen=True)
class Fit:
    """An ellipse fitted to an outline; a circle has equal axes.

    Attributes:
        centre: column and row.
        axes: half of the longer and of the shorter axis, pixels.
        angle: rad, of the longer axis.
        points: those of the outline (n, 2) that lie on it.
        agreement: their fraction of all points, 0 to 1.
    """

    centre: Array
    axes: Tuple[float, float]
    angle: float
    points: Array
    agreement: float

    @property
    def radius(self) -> float:
        """Radius of the circle of the same area."""
        return math.sqrt(self.axes[0] * self.axes[1])

    def ratios(self, points: Array) -> Array:
        """Distances of points (..., 2) from the centre, relative to the curve: 1 lies on it."""
        cosine, sine = math.cos(self.angle), math.sin(self.angle)
        turned = (points - self.centre) @ np.array([[cosine, -sine], [sine, cosine]])
        out: Array = np.linalg.norm(turned / self.axes, axis=-1)
        return out


def fit_round(points: Array, stretch: float = 1.0) -> Optional[Fit]:
    """Fit a circle to points (n, 2), or an ellipse if that agrees better.

    Args:
        points: some of them may belong to something else.
        stretch: the largest ratio of an ellipse's axes; 1 for circles only.

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


_Curve = Tuple[Array, Tuple[float, float], float]


def _fit(
    points: Array, curve_of: Callable[[Array], Optional[_Curve]], stretch: float
) -> Optional[Fit]:
    on_it = np.ones(len(points), bool)
    for _ in range(_ROUNDS):
        curve = curve_of(points[on_it]) if on_it.sum() >= 5 else None
        if curve is None:
            return None
        fit = Fit(*curve, points, 1.0)
        off = np.abs(fit.ratios(points) - 1.0)
        on_it = off <= max(_TOLERANCE, _PIXELS / fit.radius)
    if fit.axes[0] > stretch * fit.axes[1]:
        return None
    return replace(fit, points=points[on_it], agreement=float(on_it.mean()))


def _circle(points: Array) -> Optional[_Curve]:
    """Kasa's fit: x^2 + y^2 = 2 a x + 2 b y + c is linear in a, b and c."""
    origin = points.mean(axis=0)
    near = points - origin
    system = np.column_stack((2 * near, np.ones(len(near))))
    (a, b, c), *_ = np.linalg.lstsq(system, (near**2).sum(axis=1), rcond=None)
    squared = float(c + a * a + b * b)
    if not 0.0 < squared < 1e8:
        return None
    radius = math.sqrt(squared)
    return origin + np.array([a, b]), (radius, radius), 0.0


def _ellipse(points: Array) -> Optional[_Curve]:
    (x, y), (width, height), degrees = cv2.fitEllipseDirect(points.astype(np.float32))
    if not (0.0 < width < 1e4 and 0.0 < height < 1e4):
        return None
    angle = math.radians(degrees) + (0.0 if width >= height else math.pi / 2)
    return np.array([x, y]), (max(width, height) / 2, min(width, height) / 2), angle
