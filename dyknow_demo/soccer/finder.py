# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Finds round things of one colour in an image, coarse to fine.

The whole image is searched in the coarsest planes only, with wide limits of the colour. Around
each region found there, finer planes are searched for a region with a round outline: a circle is
fitted to it, and points that lie off the circle are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Iterator, Mapping, NamedTuple, Tuple

import cv2
import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer.geometry import Array

Box = Tuple[float, float, float, float]


class Colour(NamedTuple):
    """Lowest and highest values, both inclusive, of Y, U and V."""

    y: tuple[int, int]
    u: tuple[int, int]
    v: tuple[int, int]

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
#: Least pixels of a ball in the fine planes, and its largest radius as a fraction of their width.
_AREA, _SIZE = 6, 0.2
_ROUNDS = 4
#: Points within this fraction of the radius, or this many pixels, count as on the circle.
_TOLERANCE, _PIXELS = 0.12, 0.75


@dataclass(frozen=True)
class Find:
    """A round region; columns and rows are those of the image in full resolution."""

    centre: tuple[float, float]  # of the fitted circle, (column, row)
    radius: float  # pixels
    box: Box  # left, top, right, bottom of the region itself
    outline: Array  # points (n, 2) of the outline that lie on the circle
    #: 0 to 1: the fraction of the outline on the circle, times the fraction of the inside that is
    #: filled; or the score of the forest.
    score: float


def find_balls(
    pyramid: Mapping[int, Pixels], colour: Colour, roundness: float = 0.5
) -> list[Find]:
    """Find round regions of a colour that score ``roundness`` (see ``Find``), the best first.

    The pyramid has planes by their factor. Balls are searched for at the largest factor and
    confirmed at the smallest one.
    """
    coarse, fine = max(pyramid), min(pyramid)
    _, rows, columns = pyramid[fine].shape
    found: list[Find] = []
    for window in _windows(colour.mask(pyramid[coarse], _SLACK)):
        wider = np.array(window) * (coarse // fine)
        left, top, right, bottom = np.clip(wider, 0, [columns, rows] * 2).tolist()
        mask = colour.mask(pyramid[fine][:, top:bottom, left:right])
        for outline in outlines_in(mask, (left, top)):
            find = _find(outline, (columns, rows), fine)
            if find is not None and find.score >= roundness:
                found.append(find)
    found.sort(key=lambda find: (-find.score, find.centre))
    unique: list[Find] = []
    for each in found:
        if not any(
            math.dist(each.centre, other.centre) <= max(each.radius, other.radius)
            for other in unique
        ):
            unique.append(each)
    return unique


def outlines_in(mask: Pixels, offset: tuple[int, int] = (0, 0)) -> list[Any]:
    """Outlines of the connected regions of a mask, (n, 1, 2)."""
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE, offset=offset)
    return list(found)


def area_of(outline: Any) -> float:
    """Pixels of a region: its outline runs through the centres of the outermost ones."""
    return float(cv2.contourArea(outline) + len(outline) / 2 + 1)


def make_find(outline: Any, circle: Circle, factor: int, score: float) -> Find:
    """Make a find of a circle that fits an outline in planes."""
    left, top, width, height = (factor * each for each in cv2.boundingRect(outline))
    column, row = full_resolution(circle.centre, factor).tolist()
    radius, points = (circle.radius + 0.5) * factor, full_resolution(circle.points, factor)
    return Find((column, row), radius, (left, top, left + width, top + height), points, score)


def full_resolution(pixels: Array, factor: int) -> Array:
    """Columns and rows in full resolution."""
    return (pixels + 0.5) * factor - 0.5


def _windows(mask: Pixels) -> Iterator[tuple[int, int, int, int]]:
    """Left, top, right, bottom of the largest regions of a mask, with a margin."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    regions = stats[1:]
    order = np.lexsort((regions[:, 0], regions[:, 1], -regions[:, cv2.CC_STAT_AREA]))
    for left, top, width, height, _ in regions[order[:_REGIONS]].tolist():
        margin = 2 + max(width, height) // 4
        yield left - margin, top - margin, left + width + margin, top + height + margin


def _find(outline: Any, size: tuple[int, int], factor: int) -> Find | None:
    area = area_of(outline)
    circle = fit_circle(inner_points(outline, size)) if area >= _AREA else None
    if circle is None or circle.radius + 0.5 > _SIZE * size[0]:
        return None
    return make_find(
        outline, circle, factor, circle.agreement * min(1.0, area / _visible(circle, size))
    )


def inner_points(outline: Any, size: tuple[int, int]) -> Array:
    """Points (n, 2) of an outline, but not those on the border of the image."""
    points = outline.reshape(-1, 2).astype(np.float64)
    inner: Array = points[np.all((points > 0) & (points < np.array(size) - 1), axis=1)]
    return inner


def _visible(circle: Circle, size: tuple[int, int]) -> float:
    """Area of the part of a circle's inside that lies in the image."""
    reach = circle.radius + 0.5
    columns, rows = (
        np.arange(max(0, int(middle - reach)), min(count, int(middle + reach) + 2), dtype=float)
        for middle, count in zip(circle.centre, size)
    )
    grid = np.stack(np.meshgrid(columns, rows), axis=-1)
    return max(float((np.linalg.norm(grid - circle.centre, axis=-1) <= reach).sum()), 1.0)


class Circle(NamedTuple):
    """A circle fitted to an outline."""

    centre: Array  # column and row
    radius: float  # pixels
    points: Array  # those of the outline (n, 2) that lie on it
    agreement: float  # their fraction of all points, 0 to 1


def fit_circle(points: Array) -> Circle | None:
    """Fit a circle, if one fits, to points (n, 2), some of which may belong to something else."""
    on_it = np.ones(len(points), bool)
    for _ in range(_ROUNDS):
        if on_it.sum() < 5:
            return None
        # Kasa's fit: x^2 + y^2 = 2 a x + 2 b y + c is linear in a, b and c.
        origin = points[on_it].mean(axis=0)
        near = points[on_it] - origin
        system = np.column_stack((2 * near, np.ones(len(near))))
        (a, b, c), *_ = np.linalg.lstsq(system, (near**2).sum(axis=1), rcond=None)
        squared = float(c + a * a + b * b)
        if not 0.0 < squared < 1e8:
            return None
        centre, radius = origin + np.array([a, b]), math.sqrt(squared)
        off = np.abs(np.linalg.norm(points - centre, axis=1) / radius - 1.0)
        on_it = off <= max(_TOLERANCE, _PIXELS / radius)
    return Circle(centre, radius, points[on_it], float(on_it.mean()))
