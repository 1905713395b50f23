# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that exchange images which say what is in them."""

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
        """End what `start` began; the number of images so far."""
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
