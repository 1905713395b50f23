#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodes of the tutorial before and after their conversion: the same input, the same output."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import rospy
from geometry_msgs.msg import Point, PointStamped, Twist, Vector3, Vector3Stamped
from graph import Heard
from processes import BUSY, TellingCase, eventually, run
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Bool, Header
from std_srvs.srv import SetBool

VERSIONS = ("before", "after")
HEIGHT, WIDTH, RADIUS = 120, 160, 9


def picture(number, ball=None):
    """An image with a yellow ball at (x, y), or without a ball; its number is its time stamp."""
    pixels = np.full((HEIGHT, WIDTH, 3), (60, 130, 40), np.uint8)
    if ball is not None:
        cv2.circle(pixels, ball, RADIUS, (30, 200, 250), -1)
    header = Header(stamp=rospy.Time(number), frame_id="camera")
    return Image(header, HEIGHT, WIDTH, "bgr8", 0, 3 * WIDTH, pixels.tobytes())


class BothCase(TellingCase):
    """Listens to what both versions publish."""

    def listen(self, topic, *options):
        """What each version sends."""
        return [self.enter(Heard(f"/{version}/{topic}", *options)) for version in VERSIONS]

    def service(self, name):
        rospy.wait_for_service(name, 5.0 * BUSY)
        proxy = rospy.ServiceProxy(name, SetBool)
        return lambda value: self.assertTrue(proxy(value).success)


def found(ball):
    return ball.header.stamp.secs, ball.header.frame_id, ball.point


class BallFinderTest(BothCase):
    def setUp(self):
        self.balls = self.listen("ball", PointStamped, found)
        self.visible = self.listen("ball_visible", Bool, lambda message: message.data)
        self.camera = self.publisher("/camera/image", Image)
        self.number = 0
        eventually(lambda: self.send((20, 20)) and all(self.balls), 5.0, "both find a ball")
        self.found_until(self.send((20, 20)))

    def send(self, ball=None):
        self.number += 1
        self.camera.publish(picture(self.number, ball))
        return self.number

    def found_until(self, last):
        """The finds of each version since the last call, up to the image of a number."""
        for balls in self.balls:
            balls.has(lambda ball: ball[0] == last)
        every = [list(balls) for balls in self.balls]
        for balls in self.balls:
            del balls[:]
        return every

    def show(self, visible, ball=None):
        """Send images until both tell whether a ball is visible."""
        for told in self.visible:
            del told[:]
        eventually(
            lambda: self.send(ball) and all(visible in list(told) for told in self.visible),
            5.0,
            f"visible: {visible}",
        )

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
        self.show(True, (30, 40))
        self.show(False)
        self.show(True, (30, 40))

    def test_both_offer_the_service(self):
        enable = [self.service(f"/{version}/enable") for version in VERSIONS]
        for call in enable:
            call(False)
        last = self.number
        self.show(False, (50, 50))
        self.assertFalse([ball for balls in self.balls for ball in balls if ball[0] > last])
        for call in enable:
            call(True)
        before, after = self.found_until(self.send((60, 60)))
        self.assertEqual(before[-1], after[-1])


class BallBearingTest(BothCase):
    def test_both_tell_the_same_bearing(self):
        heard = self.listen(
            "bearing", Vector3Stamped, lambda bearing: (bearing.header.stamp.secs, bearing.vector)
        )
        ball = self.publisher("/seen_ball", PointStamped)
        info = self.publisher("/camera_info", CameraInfo)
        numbers = itertools.count(1)

        def both_of_one():
            """The ball at a place in the image, and the calibration with the same stamp."""
            header = Header(stamp=rospy.Time(next(numbers)), frame_id="camera")
            ball.publish(PointStamped(header, Point(180.0, 50.0, 0.0)))
            info.publish(CameraInfo(header=header, K=[200, 0, 80, 0, 100, 60, 0, 0, 1]))
            before, after = map(dict, map(list, heard))
            return [(before[stamp], after[stamp]) for stamp in before if stamp in after]

        eventually(both_of_one, 5.0, "both tell the bearing of one ball", lambda: heard)
        self.assertEqual(both_of_one()[0], (Vector3(0.5, -0.1, 1.0),) * 2)


class VelocityGuardTest(BothCase):
    def setUp(self):
        self.heard = dict(
            zip(VERSIONS, self.listen("safe_cmd_vel", Twist, lambda c: (c.linear.x, c.angular.z)))
        )
        self.command = self.publisher("/cmd_vel", Twist)

    def drive_until(self, version, speed, turn, command=None):
        """Send commands until the version passes such a speed on."""
        del self.heard[version][:]

        def drives():
            if command is not None:
                self.command.publish(command)
            return (speed, turn) in list(self.heard[version])

        eventually(drives, 5.0, f"{version} drives at {speed}")

    def test_both_limit_the_speed_and_stop_when_nobody_commands(self):
        fast = Twist(linear=Vector3(x=3.0), angular=Vector3(z=-2.0))
        for version in VERSIONS:
            self.drive_until(version, 0.5, -1.0, fast)
            self.drive_until(version, 0.0, 0.0)

    def test_both_can_be_locked(self):
        slow = Twist(linear=Vector3(x=0.25))
        for version in VERSIONS:
            lock = self.service(f"/guard_{version}/lock")
            for is_locked, speed in ((False, 0.25), (True, 0.0), (False, 0.25)):
                lock(is_locked)
                self.drive_until(version, speed, 0.0, slow)


if __name__ == "__main__":
    run()
