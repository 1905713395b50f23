#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The story of the ball in a lab: the robot leaves, another camera takes over, it returns."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

import rospy
import rostest
from geometry_msgs.msg import PointStamped
from manager_suite import eventually
from processes import HELD_UP, Running
from stream_suite import StreamCase

EXAMPLES = Path(__file__).resolve().parent.parent.parent / "examples"
LAB = EXAMPLES / "ball_in_a_lab"
os.environ["ROS_PACKAGE_PATH"] = os.pathsep.join([os.environ["ROS_PACKAGE_PATH"], str(EXAMPLES)])


class LabTest(StreamCase):
    def test_the_story(self):
        cameras = {name: str(LAB / f"{name}_cameras.xml") for name in ("robot", "fixed")}
        manager = self.make(
            ontologies=[str(LAB / "lab.ttl")],
            transformations=[str(LAB / "tracker.xml"), *cameras.values()],
        )
        manager.start()
        with Running(sys.executable, str(LAB / "follow_ball.py")) as client:
            client.wait_for("seen by robot_camera")
            (claim,) = manager.claims()
            seen = Seen(claim.topic)
            self.addCleanup(seen.close)
            seen.by("robot_camera")

            # Its battery runs low: the robot leaves, and with it its camera.
            manager.client.remove_transformation("camera(robot_camera)")
            seen.by("ceiling_camera")
            client.wait_for("seen by ceiling_camera")
            client.wait_for("?camera=ceiling_camera is ACTIVE")
            self.assertEqual(self.nodelet_of(manager, "tracker"), "/tracker_1")
            self.settled(manager)

            # It returns: an event announces the cheaper plan, which is applied on request.
            manager.client.add_transformation(Path(cameras["robot"]).read_text())
            client.wait_for("cheaper")
            manager.client.replan_stream(claim.claim_id)
            seen.by("robot_camera")
            self.settled(manager)
            self.assertEqual(self.claim(manager, claim.claim_id).topic, claim.topic)
            self.assertLess(seen.longest_pause, HELD_UP)
            client.stop()
            self.assertEqual(client.exit_code(20.0), 0)
        eventually(lambda: not manager.client.get_model().nodelets, 8.0, "all is collected")


class Seen:
    """Records which camera saw the ball, for each position."""

    def __init__(self, topic: str) -> None:
        self.longest_pause = 0.0
        self._latest = ""
        self._at = 0.0
        self._lock = threading.Lock()
        self._subscriber = rospy.Subscriber(topic, PointStamped, self._note, queue_size=100)

    def _note(self, position: PointStamped) -> None:
        now = rospy.get_time()
        with self._lock:
            if self._at:
                self.longest_pause = max(self.longest_pause, now - self._at)
            self._at, self._latest = now, position.header.frame_id

    def by(self, camera: str) -> None:
        eventually(lambda: self._latest == camera, 10.0, f"the ball is seen by {camera}")

    def close(self) -> None:
        self._subscriber.unregister()


if __name__ == "__main__":
    rospy.init_node("ball_in_a_lab_test")
    rostest.rosrun("dyknow", "ball_in_a_lab", "__main__")
