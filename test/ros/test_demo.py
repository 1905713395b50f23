#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The demonstration, run as users run it."""

from __future__ import annotations

import os
import re
import signal
import sys
from pathlib import Path

import rosgraph
from processes import Running, TellingCase, free_port, run

PICTURES = [
    f"soccer_{name}.{form}"
    for name in ("after", "before", "during", "timeline")
    for form in ("png", "svg")
]
#: Lines of the story on the soccer field.
STORY = (
    r"└─ localization\.field_position \[\?observer=nao, \?thing=ball\] \(new, cost 1\)",
    r"\+ bottom_camera_1",
    r"ACTIVE +\d+\.\d Hz  error 0\.\d+ m \(at most 0\.\d+\)  pause \d\.\d+ s  battery \d+%  bott",
    r"Holds\(charged, nao\) is FALSE: battery\.percentage = 0\.1\d+ at \d+\.\d+",
    r"RECOVERING: .*bottom_camera_1 is not available: Holds\(charged, nao\) is FALSE since ",
    r"- bottom_camera_1",
    r"image_subsampler_1.yuv <- ceiling_camera_1/image \(was bottom_camera_1/image\)",
    r"ACTIVE .* ceiling_camera",
    r"a cheaper way has appeared",
    r"replanned: new /\S*bottom_camera_1, the rest re-wired",
    r"longest pause \d\.\d+ s of 10 s that are allowed",
    r"The same nodelets tracked the ball all the time",
)


class DemoCase(TellingCase):
    def setUp(self):
        self.folder = self.make_folder()

    def start(self, *arguments, alone=False):
        """Start a demonstration, perhaps where no ROS master runs."""
        uri = f"http://localhost:{free_port()}" if alone else rosgraph.get_master_uri()
        module = (sys.executable, "-u", "-m", "dyknow_demo")
        environment = ("env", "-C", str(self.folder), f"ROS_MASTER_URI={uri}")
        demo = Running(*environment, *module, *arguments)
        self.addCleanup(demo.__exit__)
        return demo

    def read(self, demo, pattern):
        """Wait for a line, and return what is in its group."""
        demo.wait_for_match(pattern, 60.0)
        return re.search(pattern, demo.output)[1]

    def assert_interrupted(self, demo, uri, *pids):
        self.assertEqual(demo.exit_code(60.0), 130, demo.output)
        self.assertNotIn("Traceback", demo.output)
        self.assertFalse([pid for pid in pids if os.path.exists(f"/proc/{pid}")])
        self.assertFalse(rosgraph.is_master_online(uri))


class SoccerTest(DemoCase):
    def assert_told(self, demo, pictures):
        self.assertEqual(demo.exit_code(60.0), 0, demo.output)
        for line in STORY:
            self.assertRegex(demo.output, line)
        self.assertNotIn("Traceback", demo.output)
        self.assertEqual(sorted(file.name for file in pictures.iterdir()), PICTURES)
        self.assertIn("ceiling_camera_1", (pictures / "soccer_during.svg").read_text())
        self.assertTrue((pictures / "soccer_during.png").read_bytes().startswith(b"\x89PNG"))

    def test_the_story_of_a_master_of_its_own_and_of_the_launch_file(self):
        """Side by side, so the claim allows silences that a busy machine may make."""
        own = self.start("--seconds", "2.4", "--max-silence", "10", alone=True)
        words = ("--no-summary", "dyknow", "soccer.launch", "seconds:=2.4", "max_silence:=10")
        folders = (f"pictures:={self.folder}/new", f"state_dir:={self.folder}/state")
        with Running("roslaunch", *words, *folders) as launch:
            self.assert_told(launch, self.folder / "new")
        self.assertIn("process has finished cleanly", launch.output)
        self.assertIn(f"ROS master: the one at {rosgraph.get_master_uri()}", launch.output)
        self.assert_told(own, self.folder / "build" / "demo")

    def test_ctrl_c_ends_everything_and_a_manager_that_dies_is_named(self):
        demo, other = (self.start("--seconds", "30", alone=True) for _ in range(2))
        uri = self.read(demo, r"ROS master: our own, at (\S+)")
        pid = int(self.read(demo, r"manager: .* process (\d+)"))
        self.read(demo, r"(ACTIVE) .* Hz")
        tasks = Path(f"/proc/{pid}/task").glob("*/children")
        children = [each for task in tasks for each in task.read_text().split()]
        self.assertTrue(children)
        demo.stop()
        os.kill(int(self.read(other, r"manager: .* process (\d+)")), signal.SIGKILL)
        self.assert_interrupted(demo, uri, pid, *children)
        self.assertEqual(other.exit_code(60.0), 1, other.output)
        self.assertIn("the manager ended with exit code -9", other.output)


if __name__ == "__main__":
    run(is_node=False)
