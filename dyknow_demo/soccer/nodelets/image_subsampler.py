# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow_demo/ImageSubsampler: a YUV image in; other sizes and colour spaces out."""

from __future__ import annotations

from typing import Any

import cv2
from sensor_msgs.msg import Image

import dyknow
from dyknow_demo import images
from dyknow_demo.soccer.planes import halved, halved_again
from dyknow_demo.soccer.planes_message import blank_planes, planes_of


class ImageSubsampler(dyknow.Nodelet):
    """Converts and shrinks camera images; makes only those that have subscribers.

    Ports:
        yuv (in): sensor_msgs/Image, yuv422 (UYVY), rows and columns even.
        bgr (out): sensor_msgs/Image, bgr8, full size.
        hsv (out): sensor_msgs/Image, 8UC3 (OpenCV's: H 0 to 179), full size.
        yuv_half, yuv_quarter, yuv_eighth (out): sensor_msgs/Image, the planes Y, U and V one below
            the other in mono8, each with a half, a quarter, an eighth of the columns and rows.
    """

    def on_init(self) -> None:
        """Declare the ports."""
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.bgr_pub, self.hsv_pub = (
            self.nh.Publisher(port, Image, queue_size=5) for port in ("bgr", "hsv")
        )
        self.plane_pubs = [
            self.nh.Publisher(port, Image, queue_size=5)
            for port in ("yuv_half", "yuv_quarter", "yuv_eighth")
        ]
        self.sub = self.nh.Subscriber("yuv", Image, self.on_image, queue_size=2)

    def on_image(self, image: Any) -> None:
        """Make and publish the images that have subscribers."""
        if image.encoding != "yuv422" or image.height % 2 or image.width % 2:
            raise ValueError(
                f"an image of {image.width} x {image.height} in '{image.encoding}': "
                "expected yuv422 with even numbers of columns and rows"
            )
        self.publish_planes(image)
        self.publish_colours(image)

    def publish_planes(self, image: Any) -> None:
        """Publish the planes, down to the smallest with subscribers."""
        listened = [pub.get_num_connections() > 0 for pub in self.plane_pubs]
        rows, columns, before = image.height, image.width, None
        for level, pub in enumerate(self.plane_pubs):
            if not any(listened[level:]):
                return
            rows, columns = rows // 2, columns // 2
            message = blank_planes(image.header, rows, columns)
            planes = planes_of(message)
            if before is None:
                halved(images.array_of(image), planes)
            else:
                halved_again(before, planes)
            before = planes
            if listened[level]:
                pub.publish(message)

    def publish_colours(self, image: Any) -> None:
        """Publish the image in other colour spaces."""
        wants_hsv = self.hsv_pub.get_num_connections() > 0
        if not wants_hsv and not self.bgr_pub.get_num_connections():
            return
        size = image.height, image.width
        bgr = images.blank(image.header, *size, "bgr8")
        pixels = images.array_of(bgr)
        cv2.cvtColor(images.array_of(image), cv2.COLOR_YUV2BGR_UYVY, dst=pixels)
        self.bgr_pub.publish(bgr)
        if wants_hsv:
            hsv = images.blank(image.header, *size, "8UC3")
            cv2.cvtColor(pixels, cv2.COLOR_BGR2HSV, dst=images.array_of(hsv))
            self.hsv_pub.publish(hsv)
