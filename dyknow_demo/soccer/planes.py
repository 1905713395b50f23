# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The planes Y, U and V of an image, at several resolutions.

Planes are arrays of uint8, (3, rows, columns). At a factor of 2 each pixel is the mean of 2 x 2
pixels, and so on; U and V of YUV 4:2:2 have half the columns anyway. As a sensor_msgs/Image they
follow each other from top to bottom in ``mono8``: any viewer can show them.
"""

from __future__ import annotations

from typing import Any, Iterable, Sequence

import cv2
import numpy as np

from dyknow_demo.images import Pixels, array_of, blank


def shrink(packed: Pixels, smaller: Sequence[Pixels]) -> None:
    """Write planes at the factors 2, 4, 8...; an odd last row or column is left out.

    Args:
        packed: UYVY, (rows, columns, 2), both even.
        smaller: planes to be written to.
    """
    rows, columns = packed.shape[:2]
    pairs = packed.reshape(rows, columns // 2, 4)  # U, Y of the left pixel, V, Y of the right one
    half = cv2.addWeighted(pairs[0::2], 0.5, pairs[1::2], 0.5, 0.0)
    y, u, v = smaller[0]
    _, left, _, right = cv2.split(half, [u, np.empty_like(y), v, np.empty_like(y)])
    cv2.addWeighted(left, 0.5, right, 0.5, 0.0, dst=y)
    for before, after in zip(smaller, smaller[1:]):
        _, rows, columns = after.shape
        for plane, written in zip(before[:, : 2 * rows, : 2 * columns], after):
            cv2.resize(plane, (columns, rows), dst=written, interpolation=cv2.INTER_AREA)


def pyramid(packed: Pixels, factors: Iterable[int]) -> dict[int, Pixels]:
    """Make planes of an image (UYVY) at several factors: powers of 2, from 2."""
    wanted = sorted(factors)
    rows, columns = packed.shape[:2]
    made: dict[int, Pixels] = {
        1 << level: np.empty((3, rows >> level, columns >> level), np.uint8)
        for level in range(1, wanted[-1].bit_length())
    }
    shrink(packed, list(made.values()))
    return {each: made[each] for each in wanted}


def blank_planes(image: Any, levels: int) -> list[Any]:
    """Make an image for the planes of another one at each of the first factors, to be written."""
    return [
        blank(image.header, 3 * (image.height >> level), image.width >> level, "mono8")
        for level in range(1, levels + 1)
    ]


def planes_of(image: Any) -> Pixels:
    """View an image as planes (3, rows, columns).

    Raises:
        ValueError: the image does not hold three planes.
    """
    if image.encoding != "mono8" or image.height % 3:
        raise ValueError(
            f"a {image.encoding} image of {image.height} rows: expected three planes in mono8"
        )
    return array_of(image).reshape(3, image.height // 3, image.width)
