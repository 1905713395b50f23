# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The harness with a ROS master, in a process of its own: it would make this one a ROS node."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def test_the_cases_pass():
    cases = Path(__file__).with_name("ros_harness_cases.py")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(cases)],
        env={**os.environ, "ROS_MASTER_URI": "http://nobody.invalid:11311"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
