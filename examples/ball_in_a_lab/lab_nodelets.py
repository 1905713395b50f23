# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A camera and a tracker, as small as can be."""

import math

from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import Image

import dyknow

WIDTH, HEIGHT = 64, 48
BALL = 255


class Camera(dyknow.Nodelet):
    """Publishes images of a dark lab in which a bright ball goes round, once in ten seconds."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.frame = self.nh.get_param("~frame_id")
        self.pub = self.nh.Publisher("image", Image, queue_size=1)
        self.timer = self.nh.Timer(self.nh.Duration(0.1), self.on_timer)

    def on_timer(self, event):
        now = self.nh.Time.now()
        angle = 2 * math.pi * (now.to_sec() % 10.0) / 10.0
        column = round(WIDTH / 2 + 20 * math.cos(angle))
        row = round(HEIGHT / 2 + 20 * math.sin(angle))
        pixels = bytearray(WIDTH * HEIGHT)
        pixels[row * WIDTH + column] = BALL
        image = Image(height=HEIGHT, width=WIDTH, step=WIDTH, encoding="mono8", data=bytes(pixels))
        image.header.stamp = now
        image.header.frame_id = self.frame
        self.pub.publish(image)


class Tracker(dyknow.Nodelet):
    """Publishes where the ball is, in parts of the image's width and height."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.pub = self.nh.Publisher("position", PointStamped, queue_size=1)
        self.sub = self.nh.Subscriber("image", Image, self.on_image, queue_size=1)

    def on_image(self, image):
        place = image.data.find(BALL)
        if place >= 0:
            position = PointStamped(header=image.header)
            position.point.x = place % image.step / image.width
            position.point.y = place // image.step / image.height
            self.pub.publish(position)
