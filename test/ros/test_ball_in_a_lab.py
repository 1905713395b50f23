#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The story of the ball in a lab: the robot leaves, another camera takes over, it returns."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from geometry_msgs.msg import PointStamped
from graph import Heard
from processes import becomes, run
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


if __name__ == "__main__":
    run()
