#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The examples: nodes before and after their conversion, two cameras, the ball in a lab."""

from __future__ import annotations

import itertools
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from unittest import mock

import cv2
import numpy as np
import psutil
import rospy
from geometry_msgs.msg import Point, PointStamped, Twist, Vector3, Vector3Stamped
from graph import Heard
from processes import BUSY, Ended, TellingCase, becomes, eventually, finished, run
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Bool, Header
from std_srvs.srv import SetBool
from stream_suite import StreamCase
from transcripts import steps_of_page

ROOT = Path(__file__).resolve().parent.parent.parent
EXAMPLES = ROOT / "examples"
LAB = EXAMPLES / "ball_in_a_lab"
PAGE = (ROOT / "doc" / "two_cameras.rst").read_text(encoding="utf-8")
IN_WORKSPACE = "cd ~/cameras_ws 2>/dev/null; "
VERSIONS = ("before", "after")
HEIGHT, WIDTH, RADIUS = 120, 160, 9


def picture(number, ball=None):
    """An image with a yellow ball at (x, y), or without a ball; its number is its time stamp."""
    pixels = np.full((HEIGHT, WIDTH, 3), (60, 130, 40), np.uint8)
    if ball is not None:
        cv2.circle(pixels, ball, RADIUS, (30, 200, 250), -1)
    header = Header(stamp=rospy.Time(number), frame_id="camera")
    return Image(header, HEIGHT, WIDTH, "bgr8", 0, 3 * WIDTH, pixels.tobytes())


def found(ball):
    return ball.header.stamp.secs, ball.header.frame_id, ball.point


class ConvertTest(TellingCase):
    """The same input, the same output of both versions."""

    @classmethod
    def setUpClass(cls):
        launch = Ended("roslaunch", str(ROOT / "test" / "launch" / "convert.launch"))
        cls.addClassCleanup(launch.__exit__)

    def listen(self, topic, *options):
        """The messages of each version on a topic."""
        return [self.enter(Heard(f"/{version}/{topic}", *options)) for version in VERSIONS]

    def service(self, name):
        rospy.wait_for_service(name, 5.0 * BUSY)
        proxy = rospy.ServiceProxy(name, SetBool)
        return lambda value: self.assertTrue(proxy(value).success)

    def watch(self):
        """Show both a ball until they find it."""
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
        """Send images until both versions report the expected visibility of a ball."""
        for told in self.visible:
            del told[:]
        eventually(
            lambda: self.send(ball) and all(visible in list(told) for told in self.visible),
            5.0,
            f"visible: {visible}",
        )

    def test_both_find_the_same_balls(self):
        self.watch()
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
        self.watch()
        self.show(True, (30, 40))
        self.show(False)
        self.show(True, (30, 40))

    def test_both_offer_the_service(self):
        self.watch()
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

    def drive(self):
        self.driven = dict(
            zip(VERSIONS, self.listen("safe_cmd_vel", Twist, lambda c: (c.linear.x, c.angular.z)))
        )
        self.command = self.publisher("/cmd_vel", Twist)

    def drive_until(self, version, speed, turn, command=None):
        """Send commands until the version passes such a speed on."""
        del self.driven[version][:]

        def drives():
            if command is not None:
                self.command.publish(command)
            return (speed, turn) in list(self.driven[version])

        eventually(drives, 5.0, f"{version} drives at {speed}")

    def test_both_limit_the_speed_and_stop_when_nobody_commands(self):
        self.drive()
        fast = Twist(linear=Vector3(x=3.0), angular=Vector3(z=-2.0))
        for version in VERSIONS:
            self.drive_until(version, 0.5, -1.0, fast)
            self.drive_until(version, 0.0, 0.0)

    def test_both_can_be_locked(self):
        self.drive()
        slow = Twist(linear=Vector3(x=0.25))
        for version in VERSIONS:
            lock = self.service(f"/guard_{version}/lock")
            for is_locked, speed in ((False, 0.25), (True, 0.0), (False, 0.25)):
                lock(is_locked)
                self.drive_until(version, speed, 0.0, slow)


class LabTest(StreamCase):
    def test_the_story(self):
        path = os.pathsep.join([os.environ["ROS_PACKAGE_PATH"], str(EXAMPLES)])
        self.enter(mock.patch.dict(os.environ, ROS_PACKAGE_PATH=path))
        cameras = {name: str(LAB / f"{name}_cameras.xml") for name in ("robot", "fixed")}
        manager = self.make(
            ontologies=[str(LAB / "lab.ttl")],
            transformations=[str(LAB / "tracker.xml"), *cameras.values()],
        )
        manager.start()
        client = self.run_process(sys.executable, str(LAB / "follow_ball.py"))
        client.wait_for("seen by robot_camera")
        (claim,) = manager.claims()
        seen = self.enter(Heard(claim.topic, PointStamped, lambda each: each.header.frame_id))

        def is_seen_by(camera):
            becomes(lambda: seen[-1:], [camera])
            self.settled(manager)

        is_seen_by("robot_camera")
        # Its battery runs low: the robot leaves, and with it its camera.
        manager.client.remove_transformation("camera(robot_camera)")
        is_seen_by("ceiling_camera")
        client.wait_for("seen by ceiling_camera")
        client.wait_for("?camera=ceiling_camera is ACTIVE")
        self.assertEqual(self.nodelet_of(manager, "tracker"), "/tracker_1")
        # It returns: an event announces the cheaper plan, which is applied on request.
        manager.client.add_transformation(Path(cameras["robot"]).read_text())
        client.wait_for("cheaper")
        manager.client.replan_stream(claim.claim_id)
        is_seen_by("robot_camera")
        self.assertEqual(self.claim(manager, claim.claim_id).topic, claim.topic)
        client.stop()
        self.assertEqual(client.exit_code(20.0), 0)
        self.is_cleared(manager)


class TutorialTest(TellingCase):
    def setUp(self):
        self.home = self.make_folder()
        environment = {"HOME": str(self.home), "ROS_HOME": str(self.home / ".ros")}
        environment["QT_QPA_PLATFORM"] = "offscreen"
        patch = mock.patch.dict(os.environ, environment)
        patch.start()
        self.addCleanup(patch.stop)
        self.parameter("/unplugged", "")
        self.terminals = {}
        self.expected = {}

    def test_the_page(self):
        done = [self.follow(step) for step in steps_of_page(PAGE)]
        self.assertGreater(len(done), 25)
        self.assertTrue(all(each.has_ended for each in self.terminals.values()))

    def follow(self, step):
        step = replace(step, printed=self.normal(step.printed))
        if step.terminal:
            self.follow_beside(step)
            return
        code, output = finished(["bash", "-c", IN_WORKSPACE + step.line], 120.0)
        self.assertEqual(code, 0, f"{step.line}\n{output}")
        if "catkin_make" in step.line:  # its setup file takes half as long as many a command
            words = ["bash", "-c", ". ~/cameras_ws/devel/setup.bash && exec env -0"]
            done = subprocess.run(words, stdout=subprocess.PIPE, check=True, text=True)
            pairs = [each.split("=", 1) for each in done.stdout.split("\0") if each]
            os.environ.update(dict(pairs))
        output = self.normal(output).rstrip() + "\n" * bool(output.strip())
        self.assertRegex(output, rf"\A{step.pattern}\Z", step.line)

    def follow_beside(self, step):
        """Follow a terminal that goes on: its program is started, stopped, or awaited."""
        name = step.terminal
        if step.printed == "^C":
            self.terminals[name].stop()
            self.assertIn(self.terminals[name].exit_code(60.0), (0, 130))
            self.assertNotIn("Traceback", self.terminals[name].output)
            return
        if step.line:
            command = IN_WORKSPACE + "exec " + step.line
            self.terminals[name] = self.enter(Ended("bash", "-c", command))
            self.expected[name] = ""
        process = self.terminals[name]
        if not step.printed:  # the window
            program = psutil.Process(process.pid)
            asks = lambda: any(c.status == "ESTABLISHED" for c in program.connections())  # noqa: E731
            is_over = lambda: process.has_ended or asks()  # noqa: E731
            eventually(is_over, 60.0, "it is connected to the manager", lambda: process.output)
            self.assertFalse(process.has_ended, process.output)
            return
        self.expected[name] += r"(?:.*\n)*" + step.pattern
        output = lambda: self.normal(process.output)  # noqa: E731
        eventually(
            lambda: process.has_ended or re.search(self.expected[name], output()),
            60.0,
            step.printed,
            output,
        )
        self.assertRegex(output(), self.expected[name])

    def normal(self, text):
        """Replace the parts of a text that differ from run to run."""
        for pattern, instead in (
            (re.escape(str(self.home)), "/home/you"),
            (r"\d{4}(?:-\d\d){5}(?:_\d+)?", "DATE"),
            (r"\d\d:\d\d:\d\d(?:\.\d+)?", "TIME"),
            (r"\b[0-9a-f]{12}\b", "ID"),
            (r"(?<=\S) {2,}", "  "),
        ):
            text = re.sub(pattern, instead, text)
        return text


if __name__ == "__main__":
    run()
