#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The demonstration on the soccer field, run as users run it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import rosgraph
import rostest
from demo_suite import TIMEOUT, DemoCase, alone, is_running

PICTURES = [
    f"soccer_{name}.{form}" for name in ("after", "before", "during") for form in ("png", "svg")
]


class DemoTest(DemoCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def assert_told(self, output, pictures):
        for line in (
            r"└─ localization\.field_position \[\?observer=nao, \?thing=ball\] \(new, cost 1\)",
            r"\+ bottom_camera_1",
            r"ACTIVE +\d+\.\d Hz  error 0\.\d+ m \(at most 0\.\d+\)  pause \d\.\d+ s  bottom_",
            r"RECOVERING: .*bottom_camera.* (was removed|is gone)",
            r"- bottom_camera_1",
            r"image_subsampler_1.yuv <- ceiling_camera_1/image \(was bottom_camera_1/image\)",
            r"ACTIVE .* ceiling_camera",
            r"a cheaper way has appeared",
            r"replanned: new /\S*bottom_camera_1, the rest re-wired",
            r"longest pause \d\.\d+ s of 10 s that are allowed",
            r"The same nodelets tracked the ball all the time",
        ):
            self.assertRegex(output, line)
        self.assertNotIn("Traceback", output)
        self.assertEqual(sorted(file.name for file in pictures.iterdir()), PICTURES)
        during = (pictures / "soccer_during.svg").read_text()
        self.assertIn("ceiling_camera_1", during)
        self.assertTrue((pictures / "soccer_during.png").read_bytes().startswith(b"\x89PNG"))

    def test_the_story_of_a_master_of_its_own_and_of_the_launch_file(self):
        """Side by side, so the claim allows silences that a busy machine may make."""
        own = self.start("--seconds", "1.2", "--max-silence", "10", env=alone(), cwd=self.folder)
        with tempfile.TemporaryDirectory() as state:
            launch = subprocess.run(
                [
                    *("roslaunch", "--no-summary", "dyknow", "soccer.launch", "seconds:=1.2"),
                    *("max_silence:=10", f"pictures:={self.folder}/new", f"state_dir:={state}"),
                ],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=TIMEOUT,
                check=False,
            )
        self.assertEqual(launch.returncode, 0, launch.stdout)
        self.assertIn("process has finished cleanly", launch.stdout)
        self.assertIn(f"ROS master: the one at {os.environ['ROS_MASTER_URI']}", launch.stdout)
        self.assert_told(launch.stdout, self.folder / "new")
        output, _ = own.communicate(timeout=TIMEOUT)
        self.assertEqual(own.returncode, 0, output)
        self.assert_told(output, self.folder / "build" / "demo")

    def test_ctrl_c_ends_everything_and_a_manager_that_dies_is_named(self):
        demo, other = (
            self.start("--seconds", "30", env=alone(), cwd=self.folder) for _ in range(2)
        )
        uri = self.read_until(demo, r"ROS master: our own, at (\S+)")[1]
        pid = int(self.read_until(demo, r"manager: .* process (\d+)")[1])
        self.read_until(demo, r"ACTIVE .* Hz")
        children = nodelet_managers_of(pid)
        self.assertTrue(children)
        demo.send_signal(signal.SIGINT)
        os.kill(int(self.read_until(other, r"manager: .* process (\d+)")[1]), signal.SIGKILL)
        output, _ = demo.communicate(timeout=TIMEOUT)
        self.assertEqual(demo.returncode, 130, output)
        self.assertNotIn("Traceback", output)
        for each in (pid, *children):
            self.assertFalse(is_running(each))
        self.assertFalse(rosgraph.is_master_online(uri))
        output, _ = other.communicate(timeout=TIMEOUT)
        self.assertEqual(other.returncode, 1, output)
        self.assertIn("the manager ended with exit code -9", output)


def nodelet_managers_of(pid):
    """Process ids of the children of a manager."""
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(each) for task in tasks for each in re.findall(r"\d+", task.read_text())]


if __name__ == "__main__":
    rostest.rosrun("dyknow", "demo", DemoTest, sys.argv)
