# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Rendered camera frames, for where there are no real ones: a ball that rolls over a field."""

from __future__ import annotations

import math
from typing import Iterator

import cv2
import numpy as np

from dyknow_demo.images import Pixels

HEIGHT, WIDTH = 480, 640
_GRASS, _LINE, _BALL = (60, 130, 40), (240, 240, 240), (30, 200, 250)  # BGR


def render(count: int) -> Iterator[Pixels]:
    """Render one round of the ball, as ``count`` frames of (480, 640, 3), BGR."""
    field = np.full((HEIGHT, WIDTH, 3), _GRASS, np.uint8)
    centre = (WIDTH // 2, HEIGHT // 2)
    cv2.rectangle(field, (30, 30), (WIDTH - 30, HEIGHT - 30), _LINE, 4)
    cv2.line(field, (centre[0], 30), (centre[0], HEIGHT - 30), _LINE, 4)
    cv2.circle(field, centre, 70, _LINE, 4)
    for number in range(count):
        angle = 2 * math.pi * number / count
        ball = (
            round(centre[0] + 220 * math.cos(angle)),
            round(centre[1] + 150 * math.sin(angle)),
        )
        frame = field.copy()
        cv2.circle(frame, ball, 14, _BALL, -1)
        yield frame
