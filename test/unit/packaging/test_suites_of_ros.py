# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Suites of ROS's own packages have the same verdicts with live ports as without, test by test.

They run as they are, where ``DYKNOW_ROS_COMM``, ``DYKNOW_NODELET_CORE`` and ``DYKNOW_ACTIONLIB``
name checkouts of ros/ros_comm, ros/nodelet_core and ros/actionlib.
"""

from __future__ import annotations

import os
import re
import shlex
import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path
from typing import Dict, Iterable, Iterator, Optional, Sequence

import pytest
from unit.packaging.workspaces import ROOT, Workspace

from tools.processes import own_network, run_logged

#: Makes a program re-wirable.
PREFIX = "rosrun dyknow rewirable"
#: Seconds for one suite: many wait for fixed times, on top of the time that the machine needs.
TIMEOUT = 900.0
#: How often a suite runs whose verdicts differ: those of ROS have time limits of their own.
ATTEMPTS = 3
_ROSTEST = re.compile(
    r"^\s*add_rostest(?:_gtest)?\(\s*(?:[\w${}-]+\s+)?(\S+\.(?:xml|launch|test))", re.MULTILINE
)
_GTEST = re.compile(r"^\s*catkin_add_gtest\(\s*([\w${}-]+)", re.MULTILINE)

#: Tests that live ports cannot pass, and why.
EXPECTED = {
    "rospy_deregister.test_unservice": "the services of the proxy are known to the master",
}
#: The suites of actionlib that are written in Python.
ACTIONLIB = (
    "test_imports",
    "test_python_exercise_simple_client",
    "test_python_server2",
    "test_python_server3",
    "test_python_server_components",
    "test_python_simple_server",
    "test_simple_action_server_deadlock_python",
)

Verdicts = Dict[str, str]  # "ok", or why not, by the names of suite and test


def checkout(variable: str) -> Path:
    """The folder that an environment variable names; without it the test is skipped."""
    path = os.environ.get(variable, "")
    if not path:
        pytest.skip(f"{variable} names no checkout")
    return Path(path)


class Suites:
    """Suites of packages in a workspace on top of DyKnow's."""

    def __init__(
        self,
        folder: Path,
        packages: Sequence[Path],
        targets: Sequence[str],
        is_complete: bool = True,
    ) -> None:
        """Copy the packages, and build the targets: all of them, or as many as build."""
        self._is_complete = is_complete
        self._workspace = Workspace(folder / "ws", upon=[ROOT / "build/ws/devel"])
        self.source = self._workspace.folder / "src"
        self._results = folder / "results"
        self._counts: Counter[str] = Counter()
        for package in packages:
            self._workspace.add_copy(package.name, package)
        for target in targets:
            self._workspace.make(target, "-DCATKIN_ENABLE_TESTING=ON", is_complete=is_complete)
        space = self._workspace.folder if targets else ROOT / "build/ws"
        self._setup = space / "devel/setup.sh"

    def of_cpp(self, package: str) -> Iterator[Path]:
        """Find the suites of a package in C++; each of its programs with tests becomes one."""
        for file in sorted((self.source / package).rglob("CMakeLists.txt")):
            text = file.read_text().replace("${PROJECT_NAME}", package)
            yield from (file.parent / name for name in _ROSTEST.findall(text))
            for name in _GTEST.findall(text):
                suite = file.with_name(f"{name}.test")
                test = f'test-name="{name}" pkg="{package}" type="{name}" time-limit="{TIMEOUT}"'
                suite.write_text(f"<launch><test {test}/></launch>")
                yield suite

    def compare(self, suites: Iterable[Path]) -> Verdicts:
        """Return why tests fail with live ports that pass without, and print the counts."""
        differing: Verdicts = {}
        for suite in suites:
            differing.update(self._differences(suite))
        print(self._workspace.folder, dict(self._counts))
        assert self._counts["plain"] > 0, "no test passes: is libgtest-dev there to build them?"
        return differing

    def _differences(self, suite: Path) -> Verdicts:
        """Return why tests of a suite fail with live ports each time that both run."""
        differing: Optional[Verdicts] = None
        for _ in range(ATTEMPTS):
            plain, live = self._run(suite, False), self._run(suite, True)
            found = {
                name: live.get(name, "does not run")
                for name, verdict in plain.items()
                if verdict == "ok" and live.get(name) != "ok"
            }
            differing = {
                name: why for name, why in found.items() if differing is None or name in differing
            }
            if not differing:
                break
        self._counts.update(suites=1, tests=len(plain))
        self._counts["plain"] += [*plain.values()].count("ok")
        self._counts["live"] += [live.get(name) for name in plain].count("ok")
        return differing or {}

    def _run(self, suite: Path, is_live: bool) -> Verdicts:
        """Run a suite, each of its programs with live ports or as it is."""
        name = suite.with_suffix("").name
        results = self._results / name / ("live" if is_live else "plain")
        results.mkdir(parents=True, exist_ok=True)
        file = with_prefix(suite) if is_live else suite
        for report in results.glob("*/rosunit-*.xml"):
            report.unlink()
        command = ["rostest", f"--results-base-dir={results}", str(file)]
        script = (
            f". {shlex.quote(str(self._setup))}; "
            f"export ROS_PACKAGE_PATH={shlex.quote(str(self.source))}:$ROS_PACKAGE_PATH; "
            f"exec {shlex.join(command)}"
        )
        environment = {**self._workspace.environment(), "ROS_HOME": str(results)}
        run_logged(
            [*own_network(), "sh", "-c", script], results / "output.txt", TIMEOUT, environment
        )
        printed = (results / "output.txt").read_text(errors="replace")
        assert "runs as it is" not in printed, printed
        verdicts: Verdicts = {}
        for report in sorted(results.glob("*/rosunit-*.xml")):
            for case in ElementTree.parse(report).getroot().iter("testcase"):
                failures = [each for each in case if each.tag in ("failure", "error")]
                last = [(each.text or "").strip().rpartition("\n")[2] for each in failures]
                title = f"{report.stem.replace('rosunit-', '')}.{case.get('name')}"
                verdicts[title] = "; ".join(last) if failures else "ok"
        assert verdicts or is_live or not self._is_complete, f"{suite} has no tests"
        return verdicts or {name: "it has no results"}


def with_prefix(suite: Path) -> Path:
    """Write a suite beside another one in which each program has live ports; returns its path."""
    tree = ElementTree.parse(suite)
    for tag in ("node", "test"):
        for element in tree.getroot().iter(tag):
            before = element.get("launch-prefix", "")
            element.set("launch-prefix", f"{before} {PREFIX}".strip())
    file = suite.with_name(f"live_{suite.name}")
    tree.write(file)
    return file


@pytest.mark.long
def test_rospy(tmp_path):
    tests = checkout("DYKNOW_ROS_COMM") / "test"
    packages = [tests / "test_rospy", tests / "test_rosmaster"]
    suites = Suites(tmp_path, packages, ["tests", "all"])
    rostests = suites.source / "test_rospy/test/rostest"
    differing = suites.compare(sorted(rostests.glob("*.test")))
    assert set(differing) == set(EXPECTED), differing


@pytest.mark.long
def test_actionlib(tmp_path):
    suites = Suites(tmp_path, [checkout("DYKNOW_ACTIONLIB") / "actionlib"], [])
    folder = suites.source / "actionlib/test"
    assert suites.compare(folder / f"{name}.launch" for name in ACTIONLIB) == {}


@pytest.mark.long
@pytest.mark.parametrize(
    ("variable", "package"),
    [
        ("DYKNOW_ROS_COMM", "test/test_roscpp"),
        ("DYKNOW_NODELET_CORE", "test_nodelet"),
        ("DYKNOW_NODELET_CORE", "test_nodelet_topic_tools"),
        ("DYKNOW_ACTIONLIB", "actionlib"),
    ],
)
def test_cpp(tmp_path, variable, package):
    path = checkout(variable) / package
    suites = Suites(tmp_path, [path], ["tests", "all"], is_complete=False)
    assert suites.compare(suites.of_cpp(path.name)) == {}
