# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The field of the RoboCup Standard Platform League, seen from above.

Measures in metres from the league's rule book of 2015 (the last year of the orange ball),
http://spl.robocup.org. The field's frame has its origin in the middle, x along the longer side,
y to the left, z up.
"""

from __future__ import annotations

import cv2
import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer.rigid import Array

LENGTH, WIDTH = 9.0, 6.0
BORDER = 0.7
LINE = 0.05
CIRCLE_RADIUS = 0.75
BOX_DEPTH, BOX_WIDTH = 0.6, 2.2
PENALTY_CROSS, CROSS_SIZE = 1.3, 0.1
BALL_RADIUS = 0.0325

#: Metres a pixel of ``picture``.
SCALE = 0.005

GRASS = (70, 120, 50)  # BGR, as all colours here
PAINT = (225, 225, 225)

_SHIFT = 6  # fractional bits of OpenCV's drawing functions


def pixel_from_field() -> Array:
    """Homography (3 x 3) from metres on the field to pixels of ``picture``."""
    return np.array(
        [
            [1 / SCALE, 0.0, (LENGTH / 2 + BORDER) / SCALE - 0.5],
            [0.0, -1 / SCALE, (WIDTH / 2 + BORDER) / SCALE - 0.5],
            [0.0, 0.0, 1.0],
        ]
    )


def picture(seed: int) -> Pixels:
    """Draw grass and lines, (rows, columns, 3), BGR; the grass is mottled."""
    shape = (round((WIDTH + 2 * BORDER) / SCALE), round((LENGTH + 2 * BORDER) / SCALE))
    mottle = np.random.default_rng(seed).normal(0.0, 14.0, (shape[0] // 8, shape[1] // 8))
    shade = cv2.resize(mottle.astype(np.float32), shape[::-1], interpolation=cv2.INTER_LINEAR)
    field: Pixels = cv2.merge([cv2.convertScaleAbs(cv2.max(shade + each, 0)) for each in GRASS])
    half, box = LENGTH / 2, LENGTH / 2 - BOX_DEPTH
    _stroke(field, -half, -WIDTH / 2, half, WIDTH / 2)
    _stroke(field, 0.0, -WIDTH / 2, 0.0, WIDTH / 2)
    for side in (-1, 1):
        _stroke(field, side * box, -BOX_WIDTH / 2, side * half, BOX_WIDTH / 2)
        spot, arm = side * (half - PENALTY_CROSS), CROSS_SIZE / 2
        _stroke(field, spot - arm, 0.0, spot + arm, 0.0)
        _stroke(field, spot, -arm, spot, arm)
    centre, thickness = _point(0.0, 0.0), round(LINE / SCALE)
    radius = round(CIRCLE_RADIUS / SCALE * (1 << _SHIFT))
    cv2.circle(field, centre, radius, PAINT, thickness, cv2.LINE_AA, _SHIFT)
    return field


def _point(x: float, y: float) -> tuple[int, int]:
    column, row, _ = pixel_from_field() @ (x, y, 1.0)
    return round(column * (1 << _SHIFT)), round(row * (1 << _SHIFT))


def _stroke(field: Pixels, x0: float, y0: float, x1: float, y1: float) -> None:
    """Draw a line, or the outline of a rectangle, given by two corners."""
    corners = _point(x0, y0), _point(x1, y1)
    cv2.rectangle(field, *corners, PAINT, round(LINE / SCALE), cv2.LINE_AA, _SHIFT)
