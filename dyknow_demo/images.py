# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""sensor_msgs/Image as numpy arrays and back, without copying pixels.

``array_of`` is a view of the message's own data. To make a message, ask for a blank one and write
into its array; a published message must not be changed any more.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

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
    """Number of channels of an encoding.

    Raises:
        ValueError: it is none of those that are supported here.
    """
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
