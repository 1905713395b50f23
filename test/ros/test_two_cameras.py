#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tutorial with two cameras: its commands, in the order of the page, and their output."""

from __future__ import annotations

import os
import re
import sys
from dataclasses import replace
from pathlib import Path
from unittest import mock

import psutil
from processes import Ended, TellingCase, eventually, finished, run

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "test"))

from transcripts import steps_of_page  # noqa: E402

PAGE = (ROOT / "doc" / "two_cameras.rst").read_text(encoding="utf-8")
IN_WORKSPACE = "cd ~/cameras_ws 2>/dev/null; [ -f devel/setup.bash ] && . devel/setup.bash; "


class TutorialTest(TellingCase):
    def setUp(self):
        self.home = self.make_folder()
        environment = {"HOME": str(self.home), "ROS_HOME": str(self.home / ".ros")}
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
        output = self.normal(output).rstrip() + "\n" * bool(output.strip())
        self.assertRegex(output, rf"\A{step.pattern}\Z", step.line)

    def follow_beside(self, step):
        """Follow a terminal that goes on: its program is started, stopped, or awaited."""
        name = step.terminal
        if step.printed == "^C":
            self.terminals[name].stop()
            self.assertIn(self.terminals[name].exit_code(60.0), (0, 130))
            return
        if step.line:
            command = IN_WORKSPACE + "exec " + step.line
            self.terminals[name] = self.enter(Ended("bash", "-c", command))
            self.expected[name] = ""
        process = self.terminals[name]
        if not step.printed:  # the window
            program = psutil.Process(process.pid)
            asks = lambda: any(c.status == "ESTABLISHED" for c in program.connections())  # noqa: E731
            eventually(asks, 60.0, "it is connected to the manager", lambda: process.output)
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
        """Replace what differs from run to run."""
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
