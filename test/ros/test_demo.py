#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The demonstration, run as users run it."""

from __future__ import annotations

import os
import re
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
    r"Holds\(charged, nao\) is FALSE: battery\.percentage = 0\.1\d* at \d+(\.\d+)?\n",
    r"RECOVERING: .*bottom_camera_1 is not available: Holds\(charged, nao\) is FALSE since ",
    r"- bottom_camera_1",
    r"image_subsampler_1.yuv <- ceiling_camera_1/image \(was bottom_camera_1/image\)",
    r"ACTIVE .* ceiling_camera",
    r"a cheaper way has appeared",
    r"replanned: new /\S*bottom_camera_1, the rest re-wired",
    r"longest pause \d\.\d+ s of 10 s that are allowed",
    r"The same nodelets tracked the ball all the time",
)


class SoccerTest(TellingCase):
    def setUp(self):
        self.folder = self.make_folder()

    def test_the_story_of_the_launch_file(self):
        """The claim allows silences that a busy machine may make."""
        words = ("--no-summary", "dyknow", "soccer.launch", "seconds:=2.4", "max_silence:=10")
        pictures = self.folder / "new"
        folders = (f"pictures:={pictures}", f"state_dir:={self.folder}/state")
        with Running("roslaunch", *words, *folders) as launch:
            self.assertEqual(launch.exit_code(60.0), 0, launch.output)
        for line in STORY:
            self.assertRegex(launch.output, line)
        self.assertNotIn("Traceback", launch.output)
        self.assertIn("process has finished cleanly", launch.output)
        self.assertIn(f"ROS master: the one at {rosgraph.get_master_uri()}", launch.output)
        self.assertEqual(sorted(file.name for file in pictures.iterdir()), PICTURES)
        self.assertIn("ceiling_camera_1", (pictures / "soccer_during.svg").read_text())
        self.assertTrue((pictures / "soccer_during.png").read_bytes().startswith(b"\x89PNG"))

    def test_ctrl_c_ends_everything(self):
        """Where no ROS master runs."""
        where = ("env", "-C", str(self.folder), f"ROS_MASTER_URI=http://localhost:{free_port()}")
        demo = self.enter(Running(*where, sys.executable, "-m", "dyknow_demo", "--seconds", "30"))

        def read(pattern):
            demo.wait_for_match(pattern, 60.0)
            return re.search(pattern, demo.output)[1]

        uri = read(r"ROS master: our own, at (\S+)\s")
        pid = int(read(r"manager: .* process (\d+)\D"))
        read(r"(ACTIVE) .* Hz")
        tasks = Path(f"/proc/{pid}/task").glob("*/children")
        children = [each for task in tasks for each in task.read_text().split()]
        self.assertTrue(children)
        demo.stop()
        self.assertEqual(demo.exit_code(60.0), 130, demo.output)
        self.assertNotIn("Traceback", demo.output)
        self.assertFalse([each for each in (pid, *children) if os.path.exists(f"/proc/{each}")])
        self.assertFalse(rosgraph.is_master_online(uri))


if __name__ == "__main__":
    run(is_node=False)
