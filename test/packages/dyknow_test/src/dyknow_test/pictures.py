# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that exchange images with a checksum of their data."""

from __future__ import annotations

import threading
import time
import zlib

from sensor_msgs.msg import Image

from dyknow_test.puppet import Puppet


def picture(number, size):
    data = bytes([number % 251]) * size
    return Image(height=number, data=data, encoding=str(zlib.crc32(data)))


def is_whole(image):
    return image.encoding == str(zlib.crc32(image.data)) and type(image.data) is bytes


class PictureTalker(Puppet):
    """Publishes numbered images on `out`, of the given sizes in turn."""

    def set_up(self):
        self.out = self.nh.Publisher("out", Image, queue_size=self.nh.get_param("~queue_size", 10))
        self.stopped = threading.Event()
        self.number = 0

    def on_shutdown(self):
        self.stopped.set()
        super().on_shutdown()

    def start(self, rate, *sizes):
        self.stopped.clear()
        args = (1.0 / rate, sizes)
        self.thread = threading.Thread(target=self._talk, args=args, daemon=True)
        self.thread.start()

    def stop(self):
        """Stop publishing; returns the number of images so far."""
        self.stopped.set()
        self.thread.join()
        return self.number

    def publish(self, count, size):
        """Publish and return how long that took, in s."""
        start = time.monotonic()
        for _ in range(count):
            self.out.publish(picture(self.number, size))
            self.number += 1
        return time.monotonic() - start

    def _talk(self, period, sizes):
        while not self.stopped.wait(period):
            self.publish(1, sizes[self.number % len(sizes)])


class PictureListener(Puppet):
    """Notes the numbers of the images at `in`; passes them on to `out`."""

    def set_up(self):
        self.numbers = []
        self.broken = []
        self.out = self.nh.Publisher("out", Image, queue_size=100)
        self.sub = self.nh.Subscriber("in", Image, self.note)

    def note(self, image):
        (self.numbers if is_whole(image) else self.broken).append(image.height)
        self.out.publish(image)

    def received(self):
        assert not self.broken, self.broken
        return self.numbers


def gray(number):
    """A small picture, every pixel of which is the number."""
    data = number.to_bytes(2, "little") * 64
    return Image(height=8, width=8, encoding="mono16", step=16, data=data)


class Painter(Puppet):
    """Publishes gray pictures on `out`."""

    def set_up(self):
        self.out = self.nh.Publisher("out", Image, queue_size=100)
        self.number = self.nh.get_param("~first", 0)
        self.timer = None

    def paint(self, count):
        for _ in range(count):
            self.out.publish(gray(self.number))
            self.number += 1

    def paint_often(self, rate):
        period = self.nh.Duration(1.0 / rate)
        self.timer = self.nh.Timer(period, lambda event: self.paint(1))

    def spoil(self):
        """Publish an image that has no compressed form."""
        self.out.publish(Image(encoding="32FC1", height=1, width=1, step=4, data=bytes(4)))


class Viewer(Puppet):
    """Notes the numbers of gray pictures at `in`, with the topics that came in between."""

    def set_up(self):
        self.story = []
        self.sub = self.nh.Subscriber("in", Image, self.view)
        self.nh.set_reconfigure_callback(lambda inputs, outputs: self.story.append(inputs["in"]))

    def view(self, image):
        self.story.append(int.from_bytes(image.data[:2], "little"))

    def seen(self):
        return self.story
