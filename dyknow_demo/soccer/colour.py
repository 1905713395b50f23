# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Colours of balls, as boxes in YUV (ITU-R BT.601, narrow range)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Tuple

import cv2
import numpy as np

from dyknow_demo.images import Pixels

_Range = Tuple[int, int]


@dataclass(frozen=True)
class Colour:
    """Lowest and highest values, both inclusive, of Y, U and V."""

    y: _Range
    u: _Range
    v: _Range

    def mask(self, planes: Pixels) -> Pixels:
        """Mark (255) the pixels of planes (3, rows, columns) that have the colour."""
        found: Any = None
        for plane, (low, high) in zip(planes, (self.y, self.u, self.v)):
            part = cv2.inRange(plane, low, high)
            found = part if found is None else cv2.bitwise_and(found, part, dst=found)
        return np.asarray(found)

    def widened(self, slack: int) -> Colour:
        """The colour with limits of U and V that are wider by some grey levels."""
        u, v = ((low - slack, high + slack) for low, high in (self.u, self.v))
        return Colour(self.y, u, v)


#: The ball of the Standard Platform League until 2015.
ORANGE = Colour((30, 235), (0, 112), (152, 255))

#: Balls of the Middle Size League.
YELLOW = Colour((40, 235), (0, 102), (120, 155))

COLOURS = {"orange": ORANGE, "yellow": YELLOW}
