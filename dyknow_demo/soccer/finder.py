# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Finds round things of one colour in an image, coarse to fine.

The whole image is searched in the coarsest planes only, with wide limits of the colour. Around
each region found there, finer planes are searched for a region with a round outline.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Iterator, List, Mapping, Tuple

import cv2
import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer.colour import Colour
from dyknow_demo.soccer.outline import Ellipse, fit_round
from dyknow_demo.soccer.rigid import Array

_Window = Tuple[int, int, int, int]


@dataclass(frozen=True)
class Limits:
    """What counts as a ball.

    Attributes:
        slack: grey levels by which colours may be off in the coarse planes, whose pixels mix.
        regions: how many of the largest regions in the coarse planes are examined.
        area: least number of pixels of a region in the fine planes.
        roundness: least score, see ``Find``.
        size: largest radius as a fraction of the image's width.
        stretch: how much longer than wide an outline may be; 1 for circles. Lenses that distort
            need more.
    """

    slack: int = 8
    regions: int = 16
    area: int = 6
    roundness: float = 0.5
    size: float = 0.2
    stretch: float = 1.0


DEFAULT_LIMITS = Limits()


@dataclass(frozen=True)
class Find:
    """A round region; columns and rows are those of the image in full resolution.

    Attributes:
        centre: of the fitted curve, (column, row).
        radius: pixels.
        box: left, top, right, bottom of the region itself.
        outline: points (n, 2) of the outline that lie on the curve.
        score: 0 to 1: the fraction of the outline on the curve, times the fraction of the inside
            that is filled.
    """

    centre: Tuple[float, float]
    radius: float
    box: Tuple[float, float, float, float]
    outline: Array
    score: float


def find_balls(
    pyramid: Mapping[int, Pixels], colour: Colour, limits: Limits = DEFAULT_LIMITS
) -> List[Find]:
    """Find round regions of a colour, the best first.

    Args:
        pyramid: planes by their factor; balls are searched for at the largest factor and confirmed
            at the smallest one.
        colour: of the ball.
        limits: what counts as a ball.
    """
    coarse, fine = max(pyramid), min(pyramid)
    found: List[Find] = []
    for window in _windows(pyramid[coarse], colour.widened(limits.slack), limits.regions):
        found += _finds(pyramid[fine], _scaled(window, coarse // fine), fine, colour, limits)
    found.sort(key=lambda find: (-find.score, find.centre))
    unique: List[Find] = []
    for each in found:
        if all(_apart(each, better) for better in unique):
            unique.append(each)
    return unique


def _windows(planes: Pixels, colour: Colour, most: int) -> Iterator[_Window]:
    """Left, top, right, bottom of the largest regions of the colour, with a margin."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(colour.mask(planes), connectivity=8)
    regions = stats[1:]
    order = np.lexsort((regions[:, 0], regions[:, 1], -regions[:, cv2.CC_STAT_AREA]))
    for left, top, width, height, _ in regions[order[:most]].tolist():
        margin = 2 + max(width, height) // 4
        yield left - margin, top - margin, left + width + margin, top + height + margin


def _scaled(window: _Window, factor: int) -> _Window:
    left, top, right, bottom = (factor * each for each in window)
    return left, top, right, bottom


def _finds(
    planes: Pixels, window: _Window, factor: int, colour: Colour, limits: Limits
) -> Iterator[Find]:
    _, rows, columns = planes.shape
    left, top = max(window[0], 0), max(window[1], 0)
    right, bottom = min(window[2], columns), min(window[3], rows)
    mask = colour.mask(planes[:, top:bottom, left:right])
    outlines, _ = cv2.findContours(
        mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE, offset=(left, top)
    )
    for outline in outlines:
        find = _round(outline, (columns, rows), factor, limits)
        if find is not None:
            yield find


def _round(outline: Any, size: Tuple[int, int], factor: int, limits: Limits) -> Find | None:
    left, top, width, height = cv2.boundingRect(outline)
    # The outline runs through the centres of the outermost pixels: half of each lies outside.
    area = cv2.contourArea(outline) + len(outline) / 2 + 1
    if area < limits.area:
        return None
    points = outline.reshape(-1, 2).astype(np.float64)
    inside = np.all((points > 0) & (points < np.array(size) - 1), axis=1)
    fit = fit_round(points[inside], limits.stretch)  # the image's border is no part of it
    if fit is None or fit.curve.radius + 0.5 > limits.size * size[0]:
        return None
    score = fit.agreement * min(1.0, area / _visible(fit.curve, size))
    if score < limits.roundness:
        return None
    column, row = full_resolution(fit.curve.centre, factor)
    box = (left, top, left + width, top + height)
    return Find(
        (float(column), float(row)),
        (fit.curve.radius + 0.5) * factor,
        (box[0] * factor, box[1] * factor, box[2] * factor, box[3] * factor),
        full_resolution(fit.points, factor),
        float(score),
    )


def _visible(curve: Ellipse, size: Tuple[int, int]) -> float:
    """Area of the part of an ellipse that lies in the image."""
    reach = curve.axes[0] + 0.5
    columns, rows = (
        np.arange(
            max(0, int(middle - reach)), min(count, int(middle + reach) + 2), dtype=np.float64
        )
        for middle, count in zip(curve.centre, size)
    )
    grid = np.stack(np.meshgrid(columns, rows), axis=-1)
    return max(float((curve.ratios(grid) <= 1.0 + 0.5 / curve.radius).sum()), 1.0)


def full_resolution(pixels: Array, factor: int) -> Array:
    """Columns and rows in full resolution."""
    return (pixels + 0.5) * factor - 0.5


def _apart(one: Find, other: Find) -> bool:
    return float(np.hypot(*np.subtract(one.centre, other.centre))) > max(one.radius, other.radius)
