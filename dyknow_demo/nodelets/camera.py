# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow_demo/Camera: frames from files, as a camera would deliver them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, List

import cv2
from sensor_msgs.msg import Image
from std_msgs.msg import Header

import dyknow
from dyknow.errors import BadParameter
from dyknow.ros.parameters import get_positive
from dyknow_demo import images
from dyknow_demo.field import render
from dyknow_demo.rewiring.frame_names import FrameName

_RENDERED = 60


class Camera(dyknow.Nodelet):
    """Publishes frames, over and over; each is named ``camera#number`` in its ``frame_id``.

    The frames are decoded once, when the nodelet is loaded, and all messages of a frame share its
    pixels.

    Ports:
        image (out): sensor_msgs/Image, bgr8, stamped with the time of publication.

    Parameters:
        ~frames (string or list of strings, empty): a folder of images or the files themselves;
            empty: a rendered field with a ball.
        ~rate (double, 30): frames a second.
    """

    def on_init(self) -> None:
        """Decode the frames and start the timer."""
        self.nh = dyknow.NodeHandle(self.node_handle)
        rate = get_positive(self.nh, "~rate", 30.0, "Hz")
        self.camera = self.name.rpartition("/")[2]
        self.frames = self.read_frames()
        self.count = 0
        self.pub = self.nh.Publisher("image", Image, queue_size=100)
        self.timer = self.nh.Timer(self.nh.Duration(1.0 / rate), self.on_timer)

    def read_frames(self) -> List[Any]:
        """Make one message of each frame.

        Raises:
            BadParameter: there is no image where the parameter says.
        """
        given = self.nh.get_param("~frames", "")
        if not given:
            return [images.image_of(pixels, "bgr8") for pixels in render(_RENDERED)]
        if isinstance(given, str):
            files = images.image_files(Path(given)) if Path(given).is_dir() else []
        else:
            files = [Path(each) for each in given]
        decoded = [cv2.imread(str(file), cv2.IMREAD_COLOR) for file in files]
        if not decoded or any(pixels is None for pixels in decoded):
            expected = "a folder of JPEG or PNG files, or a list of such files"
            raise BadParameter(self.nh.resolve_name("~frames"), given, expected)
        return [images.image_of(pixels, "bgr8") for pixels in decoded]

    def on_timer(self, event: Any) -> None:
        """Publish the next frame."""
        frame = self.frames[self.count % len(self.frames)]
        name = FrameName(self.camera, self.count)
        self.count += 1
        header = Header(name.number, self.nh.Time.now(), str(name))
        self.pub.publish(images.with_header(header, frame))
