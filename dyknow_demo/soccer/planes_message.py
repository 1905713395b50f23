# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Planes Y, U and V as one sensor_msgs/Image.

The three planes follow each other from top to bottom in an image of encoding ``mono8``, so that
each is contiguous and any viewer can show them. ROS has no encoding for planes in this order.
"""

from __future__ import annotations

from typing import Any

from dyknow_demo.images import Pixels, array_of, blank


def blank_planes(header: Any, rows: int, columns: int) -> Any:
    """Make an image for planes of that many rows and columns, to be written to."""
    return blank(header, 3 * rows, columns, "mono8")


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
