# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Regions that may be a ball of a warm colour, in any light, and numbers that describe them.

Fixed colour limits suit only one hall. So two maps, how yellow and how orange each pixel is, are
cut at many levels each; a ball is a separate region at some of these levels. Which regions are
balls is decided by ``dyknow_demo.soccer.forest`` from the numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Iterator, List, Set, Tuple

import cv2
import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer.rigid import Array

_LEVELS = (6, 11, 17, 24, 32, 42, 54, 70)
#: Of V, in grey levels; grass lies below.
_WARM = 108
#: Pixels of the planes.
_LEAST_AREA, _LARGEST = 12, 110
_STRETCH = 4.2
#: Least fraction of its box that a region fills.
_EXTENT = 0.4

_Box = Tuple[int, int, int, int]


@dataclass(frozen=True)
class Region:
    """A connected region of the planes.

    Attributes:
        box: left, top, width, height, pixels of the planes.
        outline: as OpenCV's findContours returns it.
        features: the forest's input.
    """

    box: _Box
    outline: Any
    features: Array


def regions(planes: Pixels) -> List[Region]:
    """Find regions in planes (3, rows, columns); the same planes give the same order."""
    y, u, v = planes
    yellow: Any = np.maximum(128 - u.astype(np.int16), 0)
    orange = np.clip(yellow + v.astype(np.int16) - 128, 0, 255).astype(np.uint8)
    yellow = yellow.astype(np.uint8)
    yellow[v < _WARM] = 0
    whole = np.array([plane.mean() for plane in planes])
    edges = cv2.morphologyEx(y, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    stack = cv2.merge([y, u, v, orange])
    found: List[Region] = []
    seen: Set[_Box] = set()
    for number, plane in enumerate((yellow, orange)):
        for level in _LEVELS:
            for outline, box in _connected(plane, level):
                key = (box[0] // 2, box[1] // 2, box[2] // 2, box[3] // 2)
                if key not in seen:
                    seen.add(key)
                    numbers = _describe(stack, edges, outline, box, whole)
                    found.append(Region(box, outline, np.array([*numbers, level, number])))
    return found


def _connected(plane: Pixels, level: int) -> Iterator[Tuple[Any, _Box]]:
    mask = cv2.inRange(plane, level, 255)
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    for outline in outlines:
        if len(outline) < 8:
            continue
        left, top, width, height = cv2.boundingRect(outline)
        area = cv2.contourArea(outline) + len(outline) / 2 + 1
        if (
            area >= _LEAST_AREA
            and max(width, height) <= min(_LARGEST, _STRETCH * min(width, height))
            and area >= _EXTENT * width * height
        ):
            yield outline, (left, top, width, height)


def _describe(stack: Pixels, edges: Pixels, outline: Any, box: _Box, whole: Array) -> List[float]:
    """Colour, contrast to the surroundings, shape and shading of a region."""
    left, top, width, height = box
    margin = 2 + max(width, height) // 3
    x0, y0 = max(0, left - margin), max(0, top - margin)
    x1 = min(stack.shape[1], left + width + margin)
    y1 = min(stack.shape[0], top + height + margin)
    patch = stack[y0:y1, x0:x1]
    inside = np.zeros(patch.shape[:2], np.uint8)
    cv2.drawContours(inside, [outline], -1, 255, -1, offset=(-x0, -y0))
    outside = cv2.bitwise_not(cv2.dilate(inside, np.ones((3, 3), np.uint8)))
    mean, spread = _moments(patch, inside)
    around, around_spread = _moments(patch, outside)
    middle = top + height // 2 - y0
    upper = np.array(cv2.mean(patch[:middle], inside[:middle])[:3])
    lower = np.array(cv2.mean(patch[middle:], inside[middle:])[:3])
    above = np.array(cv2.mean(patch[:middle], outside[:middle])[:3])
    below = np.array(cv2.mean(patch[middle:], outside[middle:])[:3])
    # How well one cut, halfway, separates the region from what is around it.
    half = (mean[3] + around[3]) / 2
    warm = patch[..., 3] > half
    rim = np.zeros_like(inside)
    cv2.drawContours(rim, [outline], -1, 255, 1, offset=(-x0, -y0))
    hull = cv2.contourArea(cv2.convexHull(outline)) + len(outline) / 2 + 1
    area = cv2.contourArea(outline) + len(outline) / 2 + 1
    length = cv2.arcLength(outline, True) + 1e-6
    (_, _), (one, other), _ = cv2.minAreaRect(outline)
    rows, columns = edges.shape
    at_border = left == 0 or top == 0 or left + width == columns or top + height == rows
    brightness = max(mean[0], 16.0)
    return [
        *mean[:4],
        *spread[:4],
        *(mean - around)[:4],
        *around[:3],
        *around_spread[:4],
        *(mean[:3] - whole),
        *(upper - lower),
        *(above - below),
        (128 - mean[1]) / brightness,
        (mean[2] - 128) / brightness,
        float(warm[outside > 0].mean()) if outside.any() else 0.0,
        float(warm[inside > 0].mean()),
        cv2.mean(edges[y0:y1, x0:x1], rim)[0] / brightness,
        area**0.5,
        area / (width * height),
        area / hull,
        4 * np.pi * area / length**2,
        width / height,
        (min(one, other) + 1) / (max(one, other) + 1),
        float(at_border),
    ]


def _moments(patch: Pixels, mask: Pixels) -> Tuple[Array, Array]:
    mean, spread = cv2.meanStdDev(patch, mask=mask)
    return mean.ravel(), spread.ravel()
