# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the suites about the demonstrations: processes as users start them."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import unittest

TIMEOUT = 60.0  # s


def port_without_master():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def alone():
    """Environment with a master URI at which no master runs."""
    return {**os.environ, "ROS_MASTER_URI": f"http://127.0.0.1:{port_without_master()}"}


def is_running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


class DemoCase(unittest.TestCase):
    """Starts demonstrations and ends them."""

    arguments = ()

    def start(self, *arguments, env=None, cwd=None):
        demo = subprocess.Popen(
            [sys.executable, "-u", "-m", "dyknow_demo", *self.arguments, *arguments],
            env=env,
            cwd=cwd,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.addCleanup(demo.stdout.close)
        self.addCleanup(self.end, demo)
        return demo

    @staticmethod
    def end(demo):
        if demo.poll() is None:
            demo.terminate()
            demo.communicate(timeout=TIMEOUT)

    def read_until(self, demo, pattern):
        """Read what the demonstration prints up to a line, and return what matched in it."""
        lines = []
        for line in demo.stdout:
            lines.append(line)
            found = re.search(pattern, line)
            if found:
                return found
        self.fail(f"no line matches {pattern!r} in:\n{''.join(lines)}")

    def run_demo(self, *arguments, env=None):
        demo = self.start(*arguments, env=env)
        output, _ = demo.communicate(timeout=TIMEOUT)
        return demo.returncode, output
