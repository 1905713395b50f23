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
        self.pictures = Path(folder.name) / "new"

    def assert_told(self, output):
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
            r"longest pause \d\.\d+ s of 2 s that are allowed",
            r"The same nodelets tracked the ball all the time",
        ):
            self.assertRegex(output, line)
        self.assertNotIn("Traceback", output)
        self.assertEqual(sorted(file.name for file in self.pictures.iterdir()), PICTURES)
        during = (self.pictures / "soccer_during.svg").read_text()
        self.assertIn("ceiling_camera_1", during)
        self.assertTrue((self.pictures / "soccer_during.png").read_bytes().startswith(b"\x89PNG"))

    def test_the_story_on_the_master_that_is_there(self):
        master = rosgraph.Master("/test_demo")
        parameters = master.getParamNames()
        code, output = self.run_demo("--seconds", "1.2", "--pictures", str(self.pictures))
        self.assertEqual(code, 0, output)
        self.assert_told(output)
        self.assertIn(f"ROS master: the one at {os.environ['ROS_MASTER_URI']}", output)
        left = [name for side in master.getSystemState() for name, _ in side if "demo" in name]
        self.assertEqual(left, [])
        self.assertEqual(sorted(master.getParamNames()), sorted(parameters))

    def test_the_launch_file(self):
        with tempfile.TemporaryDirectory() as state:
            launch = subprocess.run(
                [
                    *("roslaunch", "--no-summary", "dyknow", "soccer.launch", "seconds:=1.2"),
                    *(f"pictures:={self.pictures}", f"state_dir:={state}"),
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
        self.assert_told(launch.stdout)

    def test_ctrl_c_ends_everything_that_was_started(self):
        demo = self.start("--seconds", "30", "--pictures", str(self.pictures), env=alone())
        uri = self.read_until(demo, r"ROS master: our own, at (\S+)")[1]
        pid = int(self.read_until(demo, r"manager: .* process (\d+)")[1])
        self.read_until(demo, r"ACTIVE .* Hz")
        children = nodelet_managers_of(pid)
        self.assertTrue(children)
        demo.send_signal(signal.SIGINT)
        output, _ = demo.communicate(timeout=TIMEOUT)
        self.assertEqual(demo.returncode, 130, output)
        self.assertNotIn("Traceback", output)
        for each in (pid, *children):
            self.assertFalse(is_running(each))
        self.assertFalse(rosgraph.is_master_online(uri))

    def test_a_manager_that_dies_is_named(self):
        demo = self.start("--seconds", "30", "--pictures", str(self.pictures), env=alone())
        pid = int(self.read_until(demo, r"manager: .* process (\d+)")[1])
        self.read_until(demo, r"ACTIVE .* Hz")
        os.kill(pid, signal.SIGKILL)
        output, _ = demo.communicate(timeout=TIMEOUT)
        self.assertEqual(demo.returncode, 1, output)
        self.assertIn("the manager ended with exit code -9", output)

    def test_usage(self):
        code, output = self.run_demo("--help")
        self.assertEqual(code, 0)
        self.assertIn("--rewiring", output)
        for wrong in (["--seconds", "0"], ["--max-silence", "x"], ["--frames", "."]):
            code, output = self.run_demo(*wrong)
            self.assertEqual(code, 2, output)


def nodelet_managers_of(pid):
    """Process ids of the children of a manager."""
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(each) for task in tasks for each in re.findall(r"\d+", task.read_text())]


if __name__ == "__main__":
    rostest.rosrun("dyknow", "demo", DemoTest, sys.argv)
