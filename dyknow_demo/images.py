# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""sensor_msgs/Image as numpy arrays and back, without copying pixels.

``array_of`` is a view of the message's own data. To make a message, ask for a blank one and write
into its array; a published message must not be changed any more.

The planes Y, U and V of an image are arrays of uint8, (3, rows, columns). At a factor of 2 each
pixel is the mean of 2 x 2 pixels, and so on; U and V of YUV 4:2:2 have half the columns anyway. As
a sensor_msgs/Image they follow each other from top to bottom in ``mono8``: any viewer can show
them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Iterable, Sequence

import cv2
import numpy as np
from sensor_msgs.msg import Image

if TYPE_CHECKING:
    import numpy.typing

    Pixels = numpy.typing.NDArray[np.uint8]
else:
    Pixels = np.ndarray  # the numpy of Ubuntu 20.04 has no numpy.typing

#: Channels of the encodings with 8 bits a channel that the demonstration uses; a pixel of yuv422
#: has Y and one of U and V.
CHANNELS = {"bgr8": 3, "rgb8": 3, "mono8": 1, "8UC1": 1, "8UC3": 3, "yuv422": 2}


def channels_of(encoding: str) -> int:
    """Number of channels of an encoding; raises ValueError if it is not supported here."""
    if encoding not in CHANNELS:
        raise ValueError(f"encoding '{encoding}': expected one of {', '.join(sorted(CHANNELS))}")
    return CHANNELS[encoding]


def array_of(image: Any) -> Pixels:
    """View an image as an array of uint8, (height, width) or (height, width, channels).

    Raises:
        ValueError: the encoding is not supported, or the data do not fill the image.
    """
    channels = channels_of(image.encoding)
    rows = np.frombuffer(image.data, np.uint8, image.height * image.step)
    rows = rows.reshape(image.height, image.step)[:, : image.width * channels]
    shape: tuple[int, ...] = (image.height, image.width)
    return rows.reshape(shape if channels == 1 else (*shape, channels))


def blank(header: Any, height: int, width: int, encoding: str) -> Any:
    """Make a black image whose ``array_of`` can be written to, until it is published."""
    step = width * channels_of(encoding)
    return Image(header, height, width, encoding, 0, step, bytearray(height * step))


def shrink(packed: Pixels, smaller: Sequence[Pixels]) -> None:
    """Write planes at the factors 2, 4, 8...; an odd last row or column is left out.

    ``packed`` is UYVY, (rows, columns, 2), both even; the planes are ``smaller``.
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
    """View an image as planes (3, rows, columns); raises ValueError if it does not hold three."""
    if image.encoding != "mono8" or image.height % 3:
        raise ValueError(
            f"a {image.encoding} image of {image.height} rows: expected three planes in mono8"
        )
    return array_of(image).reshape(3, image.height // 3, image.width)
