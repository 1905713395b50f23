#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Suites of roscpp, nodelet_core and actionlib: none fails with live ports alone.

They are not part of this repository. ``DYKNOW_ROS_COMM`` names checkouts of ros_comm, and of
nodelet_core and actionlib if wanted, separated by colons. The programs are built in
``build/upstream``, once; each suite runs plainly, and with the library in front of libroscpp.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import tempfile
import unittest
import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path
from typing import Iterator, Mapping, Optional, Sequence

import rospy
import rostest
from processes import TellingCase

from dyknow.cli.rewirable import find_library

CHECKOUTS = [Path(each) for each in os.environ.get("DYKNOW_ROS_COMM", "").split(":") if each]
WORKSPACE = Path(__file__).resolve().parents[2] / "build" / "upstream"
#: Those of their packages that test C++.
PACKAGES = ("test_roscpp", "test_nodelet", "test_nodelet_topic_tools", "actionlib")
ROSTEST = re.compile(
    r"^\s*add_rostest(?:_gtest)?\(\s*(?:[\w${}-]+\s+)?(\S+\.(?:xml|launch|test))", re.MULTILINE
)
GTEST = re.compile(r"^\s*catkin_add_gtest\(\s*([\w${}-]+)", re.MULTILINE)
BUILD_TIMEOUT = 3000.0  # s
SUITE_TIMEOUT = 300.0  # s
#: How often a suite is run at most, both ways, until it is not worse with live ports: some tests
#: are a matter of luck plainly too.
ATTEMPTS = 3


def run(command: Sequence[object], timeout: float, **environment: str) -> Optional[int]:
    """Runs a command without its output; returns the exit code, None if it was ended."""
    process = subprocess.Popen(
        [str(word) for word in command],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, **environment},
        start_new_session=True,
    )
    try:
        return process.wait(timeout)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return None


def build() -> None:
    """Builds what there is of the packages; a program that does not build is left out."""
    source = WORKSPACE / "src"
    source.mkdir(parents=True, exist_ok=True)
    for checkout in CHECKOUTS:
        for manifest in checkout.resolve().rglob("package.xml"):
            name = manifest.parent.name
            if name in PACKAGES and not (source / name).exists():
                (source / name).symlink_to(manifest.parent)
    options = ("-DPYTHON_EXECUTABLE=/usr/bin/python3", "-DCMAKE_BUILD_TYPE=None", "-k")
    for target in ((), ("tests",)):
        run(("catkin_make", "-C", WORKSPACE, *target, *options), BUILD_TIMEOUT)


def suites(package: str) -> Iterator[tuple[str, tuple[object, ...]]]:
    """Names of the suites of a package, and the commands that run them."""
    root = (WORKSPACE / "src" / package).resolve()
    for file in sorted(root.rglob("CMakeLists.txt")):
        text = file.read_text().replace("${PROJECT_NAME}", package)
        for name in ROSTEST.findall(text):
            yield Path(name).stem, ("rostest", file.parent / name)
        for name in GTEST.findall(text):
            program = WORKSPACE / "devel" / "lib" / package / name
            if program.exists():
                yield name, (program,)


def verdicts(name: str, command: Sequence[object], **environment: str) -> Mapping[str, str]:
    """Runs a suite and returns what became of each of its tests."""
    setup = 'source "$0/devel/setup.bash" --extend && exec "$@"'
    with tempfile.TemporaryDirectory() as folder:
        is_rostest = command[0] == "rostest"
        option = "--results-base-dir=" if is_rostest else "--gtest_output=xml:"
        words = (*command, option + folder + ("" if is_rostest else "/gtest.xml"))
        environment["ROS_HOME"] = folder
        code = run(("bash", "-c", setup, WORKSPACE, *words), SUITE_TIMEOUT, **environment)
        found = {
            f"{case.get('classname')}.{case.get('name')}": "failed"
            if case.find("failure") is not None or case.find("error") is not None
            else "passed"
            for file in sorted(Path(folder).rglob("*.xml"))
            if not file.name.startswith("rostest-")
            for case in ElementTree.parse(file).getroot().iter("testcase")
        }
    return found or {name: "did not end" if code is None else f"ended with {code}"}


def worse(plain: Mapping[str, str], live: Mapping[str, str]) -> list[str]:
    """What became worse, of each test that did."""
    return [
        f"{test}: {verdict}, with live ports {live.get(test, 'missing')}"
        for test, verdict in sorted(plain.items())
        if live.get(test) not in (verdict, "passed")
    ]


class UpstreamTest(TellingCase):
    def test_verdicts(self):
        if not CHECKOUTS:
            lacking = "DYKNOW_ROS_COMM names no checkout of ros_comm"
            print(f"skipped: {lacking}")  # rostest's results do not contain it
            raise unittest.SkipTest(lacking)
        build()
        for package in PACKAGES:
            counts: Counter[str] = Counter()
            for name, command in suites(package):
                with self.subTest(package=package, suite=name):
                    self.compare(name, command, counts)
            print(
                f"{package}: {counts['suites']} suites, {counts['tests']} tests; "
                f"{counts['plain']} pass plainly, {counts['live']} with live ports",
                flush=True,
            )

    def compare(self, name: str, command: Sequence[object], counts: Counter[str]) -> None:
        for _ in range(ATTEMPTS):
            plain = verdicts(name, command)
            live = verdicts(name, command, LD_PRELOAD=str(find_library()))
            if not worse(plain, live):
                break
        counts["suites"] += 1
        counts["tests"] += len(plain)
        counts["plain"] += list(plain.values()).count("passed")
        counts["live"] += list(live.values()).count("passed")
        self.assertEqual(worse(plain, live), [])


if __name__ == "__main__":
    rospy.init_node("cpp_upstream_test")
    rostest.rosrun("dyknow", "cpp_upstream", "__main__")
