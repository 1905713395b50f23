#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The chain of camera frames that is re-wired by hand, run as users run it."""

from __future__ import annotations

import os
import re
import signal
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import rosgraph
import rostest
from demo_suite import TIMEOUT, DemoCase, alone, is_running

ROWS = 6
BALANCED = re.compile(r"(\d+) frames at the end of the chain: 0 lost, 0 doubled, 0 out of order")


class RewiringDemoTest(DemoCase):
    arguments = ("--rewiring",)

    def assert_balanced(self, code, output):
        self.assertEqual(code, 0, output)
        found = BALANCED.search(output)
        self.assertIsNotNone(found, output)
        rows = re.findall(r"^camera_.* ms$", output, re.MULTILINE)
        self.assertEqual(len(rows), ROWS, output)
        self.assertGreater(int(found[1]), 0)

    def test_on_the_master_that_is_there_with_frames_from_files(self):
        master = rosgraph.Master("/test_demo")
        parameters = master.getParamNames()
        with tempfile.TemporaryDirectory() as folder:
            for number in range(3):
                pixels = np.full((48, 64, 3), 50 * number, np.uint8)
                cv2.imwrite(str(Path(folder) / f"{number}.jpg"), pixels)
            code, output = self.run_demo("--frames", folder, "--seconds", "0.6")
        self.assert_balanced(code, output)
        self.assertIn(f"frames: 3 real ones from {folder}", output)
        self.assertIn("32x24", output)  # subsampled
        self.assertIn("64x48", output)  # without the subsampler
        self.assertIn(f"ROS master: the one at {os.environ['ROS_MASTER_URI']}", output)
        left = [name for side in master.getSystemState() for name, _ in side if "demo" in name]
        self.assertEqual(left, [])
        self.assertEqual(sorted(master.getParamNames()), sorted(parameters))

    def test_its_own_master_and_frames_end_when_it_is_told_to(self):
        demo = self.start("--rendered", "--seconds", "30", env=alone())
        self.assertIn("rendered", self.read_until(demo, "frames: (.*)")[1])
        uri = self.read_until(demo, r"ROS master: our own, at (\S+)")[1]
        pid = int(self.read_until(demo, r"nodelet manager: .* process (\d+)")[1])
        self.read_until(demo, "-----")
        demo.send_signal(signal.SIGTERM)
        output, _ = demo.communicate(timeout=TIMEOUT)
        self.assertEqual(demo.returncode, 130, output)
        self.assertNotIn("Traceback", output)
        self.assertFalse(is_running(pid))
        self.assertFalse(rosgraph.is_master_online(uri))


if __name__ == "__main__":
    rostest.rosrun("dyknow", "demo_rewiring", RewiringDemoTest, sys.argv)
