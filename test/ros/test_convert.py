#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodes of the tutorial before and after their conversion: the same input, the same output."""

from __future__ import annotations

import itertools
import queue

import cv2
import numpy as np
import rospy
import rostest
from geometry_msgs.msg import Point, PointStamped, Twist, Vector3, Vector3Stamped
from processes import BUSY, TellingCase, eventually
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


class BothCase(TellingCase):
    """Listens to what both versions publish."""

    def listen(self, topic, datatype):
        """The messages of each version."""
        heard = {version: queue.Queue() for version in VERSIONS}
        for version, messages in heard.items():
            subscriber = rospy.Subscriber(f"/{version}/{topic}", datatype, messages.put)
            self.addCleanup(subscriber.unregister)
        return heard

    def publisher(self, topic, datatype):
        publisher = rospy.Publisher(topic, datatype, queue_size=100)
        self.addCleanup(publisher.unregister)
        return publisher

    def service(self, name):
        rospy.wait_for_service(name, TIMEOUT)
        proxy = rospy.ServiceProxy(name, SetBool)
        return lambda value: self.assertTrue(proxy(value).success)


class BallFinderTest(BothCase):
    def setUp(self):
        self.balls = self.listen("ball", PointStamped)
        self.visible = self.listen("ball_visible", Bool)
        self.camera = self.publisher("/camera/image", Image)
        self.number = 0
        waiting = set(VERSIONS)

        def all_found():
            self.send((20, 20))
            waiting.difference_update(each for each in waiting.copy() if self.balls[each].qsize())
            return not waiting

        eventually(all_found, 5.0, "both find a ball", lambda: waiting)
        self.found_until(self.send((20, 20)))

    def send(self, ball=None):
        self.number += 1
        self.camera.publish(picture(self.number, ball))
        return self.number

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
        enable = [self.service(f"/{version}/enable") for version in VERSIONS]
        for call in enable:
            call(False)
        self.send((50, 50))
        for version in VERSIONS:  # a message of the timer, which comes after that image
            self.wait_for(False)
            self.assertTrue(self.balls[version].empty())
        for call in enable:
            call(True)
        before, after = self.found_until(self.send((60, 60)))
        self.assertEqual(before, after)
        self.assertEqual(len(before), 1)


class BallBearingTest(BothCase):
    def test_both_tell_the_same_bearing(self):
        heard = self.listen("bearing", Vector3Stamped)
        ball = self.publisher("/seen_ball", PointStamped)
        info = self.publisher("/camera_info", CameraInfo)
        seen = {version: {} for version in VERSIONS}  # bearings by their stamp
        numbers = itertools.count(1)

        def both_of_one():
            """The ball at a place in the image, and the calibration with the same stamp."""
            header = Header(stamp=rospy.Time(next(numbers)), frame_id="camera")
            ball.publish(PointStamped(header, Point(180.0, 50.0, 0.0)))
            info.publish(CameraInfo(header=header, K=[200, 0, 80, 0, 100, 60, 0, 0, 1]))
            for version, messages in heard.items():
                while messages.qsize():
                    bearing = messages.get()
                    seen[version][bearing.header.stamp.secs] = bearing.vector
            return set(seen["before"]) & set(seen["after"])

        eventually(both_of_one, 5.0, "both tell the bearing of one ball", lambda: seen)
        stamp = both_of_one().pop()
        self.assertEqual(seen["before"][stamp], seen["after"][stamp])
        self.assertEqual(seen["before"][stamp], Vector3(0.5, -0.1, 1.0))


class VelocityGuardTest(BothCase):
    def setUp(self):
        self.heard = self.listen("safe_cmd_vel", Twist)
        self.command = self.publisher("/cmd_vel", Twist)

    def drive_until(self, version, speed, turn, command=None):
        """Send commands until the version passes such a speed on."""

        def drives():
            if command is not None:
                self.command.publish(command)
            heard = self.heard[version]
            safe = [heard.get() for _ in range(heard.qsize())]
            return (speed, turn) in [(each.linear.x, each.angular.z) for each in safe]

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
    rospy.init_node("test_convert")
    rostest.rosrun("dyknow", "convert", "__main__")
