# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelets of the re-wired chain: a camera, two stages, and one that keeps account."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Iterator, Tuple

import cv2
import numpy as np
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from std_srvs.srv import Trigger, TriggerResponse

import dyknow
from dyknow.errors import BadParameter
from dyknow.ros.parameters import get_positive
from dyknow_demo import images
from dyknow_demo.accounting import FrameName

_RENDERED = 60
_HEIGHT, _WIDTH = 480, 640
_GRASS, _LINE, _BALL = (60, 130, 40), (240, 240, 240), (30, 200, 250)  # BGR
#: OpenCV's conversion from BGR and the encoding of the result; ROS has no names for YUV and HSV
#: with full resolution.
_CONVERSIONS = {
    "hsv": (cv2.COLOR_BGR2HSV, "8UC3"),
    "mono": (cv2.COLOR_BGR2GRAY, "mono8"),
    "rgb": (cv2.COLOR_BGR2RGB, "rgb8"),
    "yuv": (cv2.COLOR_BGR2YUV, "8UC3"),
}
#: One image: its frame_id, when it was stamped, when it came (s, ROS time), width and height.
Arrival = Tuple[str, float, float, int, int]


def render(count: int) -> Iterator[images.Pixels]:
    """Render a ball's round over a field, as ``count`` frames of (480, 640, 3), BGR."""
    field = np.full((_HEIGHT, _WIDTH, 3), _GRASS, np.uint8)
    x, y = _WIDTH // 2, _HEIGHT // 2
    cv2.rectangle(field, (30, 30), (_WIDTH - 30, _HEIGHT - 30), _LINE, 4)
    cv2.line(field, (x, 30), (x, _HEIGHT - 30), _LINE, 4)
    cv2.circle(field, (x, y), 70, _LINE, 4)
    for number in range(count):
        angle = 2 * math.pi * number / count
        frame = field.copy()
        ball = round(x + 220 * math.cos(angle)), round(y + 150 * math.sin(angle))
        cv2.circle(frame, ball, 14, _BALL, -1)
        yield frame


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

    def read_frames(self) -> list[Any]:
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


class Reporter(dyknow.Nodelet):
    """Logs rate, latency, and frames lost and doubled; hands out its records on request.

    Frames between two of the same camera that never came are logged as lost, so a re-wiring to
    another camera and back shows as a gap: only the records, compared with the published frames,
    show which frames a re-wiring lost.

    Ports:
        image (in): sensor_msgs/Image with ``camera#number`` as ``frame_id``.

    Parameters:
        ~period (double, 10): seconds from one line in the log to the next.

    Services:
        ~arrivals (std_srvs/Trigger): all records since the load as JSON, a list of ``[frame_id,
            stamp in s, arrival in s, width, height]`` in the order of arrival.
    """

    def on_init(self) -> None:
        """Declare the port, offer the service and start the timer."""
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.period = get_positive(self.nh, "~period", 10.0, "s")
        self.arrivals: list[Arrival] = []
        self.reported = 0
        self.latest: dict[str, int] = {}
        self.lost = self.doubled = 0
        self.sub = self.nh.Subscriber("image", Image, self.on_image, queue_size=100)
        self.service = self.nh.Service("~arrivals", Trigger, self.on_request)
        self.timer = self.nh.Timer(self.nh.Duration(self.period), self.on_timer)

    def on_image(self, image: Any) -> None:
        """Record one image."""
        now = self.nh.get_time()
        header = image.header
        self.arrivals.append(
            (header.frame_id, header.stamp.to_sec(), now, image.width, image.height)
        )
        name = FrameName.parse(header.frame_id)
        last = self.latest.get(name.camera, name.number - 1)
        if name.number <= last:
            self.doubled += 1
        else:
            self.lost += name.number - last - 1
            self.latest[name.camera] = name.number

    def on_request(self, request: Any) -> Any:
        """Hand out the records."""
        return TriggerResponse(True, json.dumps(self.arrivals))

    def on_timer(self, event: Any) -> None:
        """Log the images since the last time, and those missing since the start."""
        recent = self.arrivals[self.reported :]
        self.reported = len(self.arrivals)
        line = f"{len(recent)} images, {len(recent) / self.period:.1f} Hz"
        if recent:
            mean = sum(arrived - sent for _, sent, arrived, _, _ in recent) / len(recent)
            line += f", latency {1000 * mean:.2f} ms on average"
        self.nh.loginfo(
            "%s: %s; since the start %d lost, %d doubled",
            self.name,
            line,
            self.lost,
            self.doubled,
        )
