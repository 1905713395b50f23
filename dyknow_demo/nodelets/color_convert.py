# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow_demo/ColorConvert: the same picture in another colour space."""

from __future__ import annotations

from typing import Any

import cv2
from sensor_msgs.msg import Image

import dyknow
from dyknow.errors import BadParameter
from dyknow_demo import images

#: OpenCV's conversion from BGR and the encoding of the result; ROS has no names for YUV and HSV
#: with full resolution.
_CONVERSIONS = {
    "hsv": (cv2.COLOR_BGR2HSV, "8UC3"),
    "mono": (cv2.COLOR_BGR2GRAY, "mono8"),
    "rgb": (cv2.COLOR_BGR2RGB, "rgb8"),
    "yuv": (cv2.COLOR_BGR2YUV, "8UC3"),
}


class ColorConvert(dyknow.Nodelet):
    """Converts images from BGR to another colour space.

    Ports:
        image (in): sensor_msgs/Image, bgr8.
        converted (out): sensor_msgs/Image, 8UC3 for hsv and yuv, else mono8 or rgb8.

    Parameters:
        ~encoding (string, yuv): hsv, mono, rgb or yuv.
    """

    def on_init(self) -> None:
        """Declare the ports."""
        self.nh = dyknow.NodeHandle(self.node_handle)
        name = self.nh.get_param("~encoding", "yuv")
        if name not in _CONVERSIONS:
            expected = "one of " + ", ".join(sorted(_CONVERSIONS))
            raise BadParameter(self.nh.resolve_name("~encoding"), name, expected)
        self.code, self.encoding = _CONVERSIONS[name]
        self.pub = self.nh.Publisher("converted", Image, queue_size=100)
        self.sub = self.nh.Subscriber("image", Image, self.on_image, queue_size=100)

    def on_image(self, image: Any) -> None:
        """Convert one image; OpenCV writes into the message that goes out."""
        if image.encoding != "bgr8":
            raise ValueError(f"an image came in encoding '{image.encoding}': expected bgr8")
        converted = images.blank(image.header, image.height, image.width, self.encoding)
        cv2.cvtColor(images.array_of(image), self.code, dst=images.array_of(converted))
        self.pub.publish(converted)
