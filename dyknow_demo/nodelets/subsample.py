# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow_demo/Subsample: the same picture with fewer pixels."""

from __future__ import annotations

from typing import Any

import cv2
from sensor_msgs.msg import Image

import dyknow
from dyknow.errors import BadParameter
from dyknow_demo import images


class Subsample(dyknow.Nodelet):
    """Makes images smaller; each pixel is the mean of those it stands for.

    Ports:
        image (in): sensor_msgs/Image with 8 bits a channel.
        subsampled (out): sensor_msgs/Image of the same encoding.

    Parameters:
        ~factor (int, 2): pixels of the input, in each direction, for one of the output.
    """

    def on_init(self) -> None:
        """Declare the ports."""
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.factor = self.nh.get_param("~factor", 2)
        if not isinstance(self.factor, int) or self.factor < 1:
            name = self.nh.resolve_name("~factor")
            raise BadParameter(name, self.factor, "an integer from 1")
        self.pub = self.nh.Publisher("subsampled", Image, queue_size=100)
        self.sub = self.nh.Subscriber("image", Image, self.on_image, queue_size=100)

    def on_image(self, image: Any) -> None:
        """Shrink one image; OpenCV writes into the message that goes out."""
        height = max(1, image.height // self.factor)
        width = max(1, image.width // self.factor)
        small = images.blank(image.header, height, width, image.encoding)
        pixels = images.array_of(small)
        cv2.resize(
            images.array_of(image), (width, height), dst=pixels, interpolation=cv2.INTER_AREA
        )
        self.pub.publish(small)
