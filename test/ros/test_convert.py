#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodes of the tutorial before and after their conversion: the same input, the same output."""

from __future__ import annotations

import queue
import time
import unittest

import cv2
import numpy as np
import rospy
import rostest
from geometry_msgs.msg import Point, PointStamped, Twist, Vector3, Vector3Stamped
from processes import BUSY
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Bool, Header
from std_srvs.srv import SetBool

VERSIONS = ("before", "after")
TIMEOUT = 5.0 * BUSY  # s
HEIGHT, WIDTH, RADIUS = 120, 160, 9


def picture(number, ball=None):
    """An image with a yellow ball at (x, y), or without a ball; its number is its time stamp."""
    pixels = np.full((HEIGHT, WIDTH, 3), (60, 130, 40), np.uint8)
    if ball is not None:
        cv2.circle(pixels, ball, RADIUS, (30, 200, 250), -1)
    header = Header(stamp=rospy.Time(number), frame_id="camera")
    return Image(header, HEIGHT, WIDTH, "bgr8", 0, 3 * WIDTH, pixels.tobytes())


class BallFinderTest(unittest.TestCase):
    def setUp(self):
        self.balls = {version: queue.Queue() for version in VERSIONS}
        self.visible = {version: queue.Queue() for version in VERSIONS}
        for version in VERSIONS:
            self.listen(f"/{version}/ball", PointStamped, self.balls[version])
            self.listen(f"/{version}/ball_visible", Bool, self.visible[version])
        self.camera = rospy.Publisher("/camera/image", Image, queue_size=100)
        self.addCleanup(self.camera.unregister)
        self.number = 0
        self.connect()

    def listen(self, topic, datatype, messages):
        subscriber = rospy.Subscriber(topic, datatype, messages.put)
        self.addCleanup(subscriber.unregister)

    def send(self, ball=None):
        self.number += 1
        self.camera.publish(picture(self.number, ball))
        return self.number

    def connect(self):
        """Send balls until both have found one, and wait until both have processed the last."""
        waiting = set(VERSIONS)
        deadline = time.monotonic() + TIMEOUT
        while waiting:
            self.assertLess(time.monotonic(), deadline, f"nothing comes from {sorted(waiting)}")
            self.send((20, 20))
            for version in sorted(waiting):
                try:
                    self.balls[version].get(timeout=0.1)
                    waiting.remove(version)
                except queue.Empty:
                    continue
        self.found_until(self.send((20, 20)))

    def found_until(self, last):
        """The finds of each version, up to the image of a number."""
        found = {version: [] for version in VERSIONS}
        for version, balls in found.items():
            while not balls or balls[-1].header.stamp.secs != last:
                balls.append(self.balls[version].get(timeout=TIMEOUT))
        return [
            [(ball.header.stamp.secs, ball.header.frame_id, ball.point) for ball in found[version]]
            for version in VERSIONS
        ]

    def wait_for(self, visible):
        for version in VERSIONS:
            while self.visible[version].get(timeout=TIMEOUT).data is not visible:
                pass

    def test_both_find_the_same_balls(self):
        for x in range(RADIUS, WIDTH - RADIUS, 10):
            # Not more at once than their queues hold: a full queue drops images.
            for ball in ((x, HEIGHT // 2), None, (x + 1, 20), None):
                self.send(ball)
            before, after = self.found_until(self.send((30, 40)))
            self.assertEqual(before, after)
            self.assertEqual(len(before), 3)
        self.assertAlmostEqual(before[-1][2].x, 30)
        self.assertAlmostEqual(before[-1][2].y, 40)

    def test_both_tell_whether_the_ball_is_visible(self):
        self.wait_for(True)
        self.wait_for(False)
        self.send((30, 40))
        self.wait_for(True)

    def test_both_offer_the_service(self):
        for version in VERSIONS:
            rospy.wait_for_service(f"/{version}/enable", TIMEOUT)
        enable = [rospy.ServiceProxy(f"/{version}/enable", SetBool) for version in VERSIONS]
        for call in enable:
            self.assertTrue(call(False).success)
        self.send((50, 50))
        for version in VERSIONS:  # a message of the timer, which comes after that image
            self.wait_for(False)
            self.assertTrue(self.balls[version].empty())
        for call in enable:
            self.assertTrue(call(True).success)
        before, after = self.found_until(self.send((60, 60)))
        self.assertEqual(before, after)
        self.assertEqual(len(before), 1)


class OutputsTest(unittest.TestCase):
    """Base of tests that listen to what both versions publish."""

    def listen(self, topic, datatype):
        self.heard = {version: queue.Queue() for version in VERSIONS}
        for version, messages in self.heard.items():
            subscriber = rospy.Subscriber(f"/{version}/{topic}", datatype, messages.put)
            self.addCleanup(subscriber.unregister)

    def publisher(self, topic, datatype):
        publisher = rospy.Publisher(topic, datatype, queue_size=10)
        self.addCleanup(publisher.unregister)
        return publisher


class BallBearingTest(OutputsTest):
    def setUp(self):
        self.listen("bearing", Vector3Stamped)
        self.ball = self.publisher("/seen_ball", PointStamped)
        self.info = self.publisher("/camera_info", CameraInfo)
        self.number = 0

    def send(self, x, y):
        """The ball at a place in the image, and the calibration with the same stamp."""
        self.number += 1
        header = Header(stamp=rospy.Time(self.number), frame_id="camera")
        self.ball.publish(PointStamped(header, Point(x, y, 0.0)))
        self.info.publish(CameraInfo(header=header, K=[200, 0, 80, 0, 100, 60, 0, 0, 1]))
        return self.number

    def bearing_of(self, version, number):
        """The bearing with the stamp of that number, or None when none comes soon."""
        try:
            while True:
                bearing = self.heard[version].get(timeout=0.2)
                if bearing.header.stamp.secs == number:
                    return bearing
        except queue.Empty:
            return None

    def test_both_tell_the_same_bearing(self):
        deadline = time.monotonic() + TIMEOUT
        while True:
            self.assertLess(time.monotonic(), deadline, "not both tell a bearing")
            number = self.send(180.0, 50.0)
            bearings = [self.bearing_of(version, number) for version in VERSIONS]
            if None not in bearings:
                break
        self.assertEqual(bearings[0].vector, bearings[1].vector)
        self.assertEqual(bearings[0].vector, Vector3(0.5, -0.1, 1.0))


class VelocityGuardTest(OutputsTest):
    def setUp(self):
        self.listen("safe_cmd_vel", Twist)
        self.command = self.publisher("/cmd_vel", Twist)

    def drive_until(self, version, speed, turn, command=None):
        """Send commands until the version passes such a speed on."""
        deadline = time.monotonic() + TIMEOUT
        while True:
            self.assertLess(time.monotonic(), deadline, f"{version} never drives at {speed}")
            if command is not None:
                self.command.publish(command)
            safe = self.heard[version].get(timeout=TIMEOUT)
            if (safe.linear.x, safe.angular.z) == (speed, turn):
                return

    def test_both_limit_the_speed_and_stop_when_nobody_commands(self):
        for version in VERSIONS:
            fast = Twist(linear=Vector3(x=3.0), angular=Vector3(z=-2.0))
            self.drive_until(version, 0.5, -1.0, fast)
            self.drive_until(version, 0.0, 0.0)

    def test_both_can_be_locked(self):
        slow = Twist(linear=Vector3(x=0.25))
        for version in VERSIONS:
            rospy.wait_for_service(f"/guard_{version}/lock", TIMEOUT)
            lock = rospy.ServiceProxy(f"/guard_{version}/lock", SetBool)
            self.drive_until(version, 0.25, 0.0, slow)
            self.assertTrue(lock(True).success)
            self.drive_until(version, 0.0, 0.0, slow)
            self.assertTrue(lock(False).success)
            self.drive_until(version, 0.25, 0.0, slow)


if __name__ == "__main__":
    rospy.init_node("test_convert")
    rostest.rosrun("dyknow", "convert", "__main__")
