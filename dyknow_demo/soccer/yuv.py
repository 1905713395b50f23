# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""YUV 4:2:2 as cameras deliver it, and the conversion from BGR.

ITU-R BT.601 with its narrow range (Y 16 to 235), which OpenCV's conversions from YUV 4:2:2 assume.
Packed pixels are in the order UYVY, which is ROS's encoding ``yuv422``.
"""

from __future__ import annotations

import cv2
import numpy as np

from dyknow_demo.images import Pixels

_YUV_FROM_BGR = np.array(
    [
        [0.098, 0.504, 0.257, 16.0],
        [0.439, -0.291, -0.148, 128.0],
        [-0.071, -0.368, 0.439, 128.0],
    ]
)


def yuv_from_bgr(pixels: Pixels) -> Pixels:
    """Convert (rows, columns, 3)."""
    converted: Pixels = cv2.transform(pixels, _YUV_FROM_BGR)
    return converted


def pack(pixels: Pixels, packed: Pixels) -> None:
    """Write YUV (rows, columns, 3) as UYVY into (rows, columns, 2); columns are even.

    Two neighbours share the colour of the left one.
    """
    packed[..., 1] = pixels[..., 0]
    packed[:, 0::2, 0] = pixels[:, 0::2, 1]
    packed[:, 1::2, 0] = pixels[:, 0::2, 2]
