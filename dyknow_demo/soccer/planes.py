# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The planes Y, U and V of an image, at several resolutions.

Planes are arrays of uint8, (3, rows, columns): each plane is contiguous. At a factor of 2 each
pixel is the mean of 2 x 2 pixels, and so on; U and V of YUV 4:2:2 have half the columns anyway.
"""

from __future__ import annotations

from typing import Dict, Iterable

import cv2
import numpy as np

from dyknow_demo.images import Pixels


def halved(packed: Pixels, planes: Pixels) -> None:
    """Write planes at a factor of 2.

    Args:
        packed: UYVY, (rows, columns, 2), both even.
        planes: (3, rows / 2, columns / 2), to be written to.
    """
    rows, columns = packed.shape[:2]
    pairs = packed.reshape(rows, columns // 2, 4)  # U, Y of the left pixel, V, Y of the right one
    half = cv2.addWeighted(pairs[0::2], 0.5, pairs[1::2], 0.5, 0.0)
    y, u, v = planes
    _, left, _, right = cv2.split(half, [u, np.empty_like(y), v, np.empty_like(y)])
    cv2.addWeighted(left, 0.5, right, 0.5, 0.0, dst=y)


def halved_again(planes: Pixels, smaller: Pixels) -> None:
    """Write planes at twice the factor; an odd last row or column is left out."""
    _, rows, columns = smaller.shape
    for plane, half in zip(planes, smaller):
        even = plane[: 2 * rows, : 2 * columns]
        cv2.resize(even, (columns, rows), dst=half, interpolation=cv2.INTER_AREA)


def pyramid(packed: Pixels, factors: Iterable[int]) -> Dict[int, Pixels]:
    """Make planes of an image (UYVY) at several factors.

    Args:
        packed: (rows, columns, 2), both even.
        factors: powers of 2, from 2.
    """
    wanted = set(factors)
    rows, columns = packed.shape[0] // 2, packed.shape[1] // 2
    planes: Pixels = np.empty((3, rows, columns), np.uint8)
    halved(packed, planes)
    factor, made = 2, {2: planes}
    while factor < max(wanted):
        factor, rows, columns = 2 * factor, rows // 2, columns // 2
        made[factor] = np.empty((3, rows, columns), np.uint8)
        halved_again(made[factor // 2], made[factor])
    return {each: made[each] for each in sorted(wanted)}
