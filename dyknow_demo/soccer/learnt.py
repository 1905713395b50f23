# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Balls of a warm colour in any light: regions that may be one, and a forest that scores them.

Fixed colour limits suit only one hall. So two maps, how yellow and how orange each pixel is, are
cut at many levels each; a ball is a separate region at some of these levels. Which regions are
balls is decided by a random forest of OpenCV's, which ``dyknow_demo.soccer.learn`` trains.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple, Sequence, Tuple

import cv2
import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer.finder import (
    Find,
    area_of,
    fit_circle,
    inner_points,
    make_find,
    outlines_in,
)
from dyknow_demo.soccer.geometry import Array

MODEL = Path(__file__).with_name("ball_forest.yml.gz")  # the shipped model, trained on all days
THRESHOLD = 0.16  # threshold of the shipped model, as printed by ``learn``

_LEVELS = (6, 11, 17, 24, 32, 42, 54, 70)
_WARM = 108  # of V, in grey levels; grass lies below
#: Pixels of the planes.
_LEAST_AREA, _LARGEST = 12, 110
#: The most that a region's box may be longer than wide, and the least fraction of it that is
#: filled.
_BOX_STRETCH, _EXTENT = 4.2, 0.4
_SHARED = 0.3  # two finds overlap by at most this fraction of the smaller one's box

_Box = Tuple[int, int, int, int]


class Region(NamedTuple):
    """A connected region of planes."""

    box: _Box  # left, top, width, height, pixels of the planes
    outline: Any  # as OpenCV's findContours returns it
    features: Array  # the forest's input


def load_forest(file: Path = MODEL) -> Any:
    """Read a forest; raises ValueError if the file holds none."""
    try:
        return cv2.ml.RTrees_load(str(file))
    except (cv2.error, SystemError):
        raise ValueError(f"{file} is no forest") from None


def find_learnt(
    planes: Pixels, factor: int, forest: Any, threshold: float = THRESHOLD
) -> list[Find]:
    """Find balls in planes (3, rows, columns) at a factor, the best first."""
    finds = []
    for score, region in best_regions(regions(planes), forest, threshold):
        points = inner_points(region.outline, (planes.shape[2], planes.shape[1]))
        circle = fit_circle(points)
        if circle is not None:
            finds.append(make_find(region.outline, circle, factor, score))
    return finds


def best_regions(
    found: Sequence[Region], forest: Any, threshold: float
) -> list[tuple[float, Region]]:
    """Choose regions of at least the threshold that overlap no better one, the best first."""
    if not found:
        return []
    scores = forest.predict(np.array([each.features for each in found], np.float32))[1].ravel()
    chosen: list[tuple[float, Region]] = []
    for number in np.argsort(-scores, kind="stable"):
        region, score = found[number], float(scores[number])
        if score < threshold:
            break
        if all(_shared(region.box, other.box) <= _SHARED for _, other in chosen):
            chosen.append((score, region))
    return chosen


def _shared(one: _Box, other: _Box) -> float:
    """Intersection of two boxes as a fraction of the smaller one."""
    width = min(one[0] + one[2], other[0] + other[2]) - max(one[0], other[0])
    height = min(one[1] + one[3], other[1] + other[3]) - max(one[1], other[1])
    return max(width, 0) * max(height, 0) / min(one[2] * one[3], other[2] * other[3])


def regions(planes: Pixels) -> list[Region]:
    """Find regions in planes (3, rows, columns); the same planes give the same order."""
    y, u, v = planes
    yellow: Any = np.maximum(128 - u.astype(np.int16), 0)
    orange = np.clip(yellow + v.astype(np.int16) - 128, 0, 255).astype(np.uint8)
    yellow = yellow.astype(np.uint8)
    yellow[v < _WARM] = 0
    whole = np.array([plane.mean() for plane in planes])
    edges = cv2.morphologyEx(y, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    stack = cv2.merge([y, u, v, orange])
    found: list[Region] = []
    seen: set[tuple[int, ...]] = set()
    for number, plane in enumerate((yellow, orange)):
        for level in _LEVELS:
            for outline in outlines_in(cv2.inRange(plane, level, 255)):
                if len(outline) < 8:
                    continue
                box = cv2.boundingRect(outline)
                key = tuple(each // 2 for each in box)
                if _may_be_ball(outline, box) and key not in seen:
                    seen.add(key)
                    numbers = _describe(stack, edges, outline, box, whole)
                    found.append(Region(box, outline, np.array([*numbers, level, number])))
    return found


def _may_be_ball(outline: Any, box: _Box) -> bool:
    width, height = box[2:]
    largest = min(_LARGEST, _BOX_STRETCH * min(width, height))
    least = max(_LEAST_AREA, _EXTENT * width * height)
    return max(width, height) <= largest and area_of(outline) >= least


def _describe(stack: Pixels, edges: Pixels, outline: Any, box: _Box, whole: Array) -> list[float]:
    """Colour, contrast to the surroundings, shape and shading of a region."""
    left, top, width, height = box
    rows, columns = edges.shape
    margin = 2 + max(width, height) // 3
    x0, y0 = max(0, left - margin), max(0, top - margin)
    window = np.s_[y0 : top + height + margin, x0 : left + width + margin]
    patch = stack[window]
    inside, rim = np.zeros((2, *patch.shape[:2]), np.uint8)
    cv2.drawContours(inside, [outline], -1, 255, -1, offset=(-x0, -y0))
    cv2.drawContours(rim, [outline], -1, 255, 1, offset=(-x0, -y0))
    outside = cv2.bitwise_not(cv2.dilate(inside, np.ones((3, 3), np.uint8)))
    mean, spread, around, around_spread = (
        each.ravel() for mask in (inside, outside) for each in cv2.meanStdDev(patch, mask=mask)
    )
    middle = top + height // 2 - y0
    upper, lower, above, below = (
        np.array(cv2.mean(patch[part], mask[part])[:3])
        for mask in (inside, outside)
        for part in (slice(middle), slice(middle, None))
    )
    # How well one cut, halfway, separates the region from its surroundings.
    warm = patch[..., 3] > (mean[3] + around[3]) / 2
    area, hull = area_of(outline), cv2.contourArea(cv2.convexHull(outline)) + len(outline) / 2 + 1
    length = cv2.arcLength(outline, True) + 1e-6
    (_, _), (one, other), _ = cv2.minAreaRect(outline)
    at_border = left == 0 or top == 0 or left + width == columns or top + height == rows
    brightness = max(mean[0], 16.0)
    return [
        *mean,
        *spread,
        *(mean - around),
        *around[:3],
        *around_spread,
        *(mean[:3] - whole),
        *(upper - lower),
        *(above - below),
        (128 - mean[1]) / brightness,
        (mean[2] - 128) / brightness,
        float(warm[outside > 0].mean()) if outside.any() else 0.0,
        float(warm[inside > 0].mean()),
        cv2.mean(edges[window], rim)[0] / brightness,
        area**0.5,
        area / (width * height),
        area / hull,
        4 * np.pi * area / length**2,
        width / height,
        (min(one, other) + 1) / (max(one, other) + 1),
        float(at_border),
    ]
