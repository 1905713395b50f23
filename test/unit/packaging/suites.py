# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Rostest suites of ROS's own packages, run plainly and with live ports, test by test.

They are read from a checkout that an environment variable points to, and run as they are.
"""

from __future__ import annotations

import os
import shlex
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Dict, Optional, Sequence

import pytest
from unit.packaging.workspaces import ROOT, Workspace

from tools.processes import own_network, run_logged

#: Makes a program re-wirable.
PREFIX = "rosrun dyknow rewirable"
#: Seconds for one suite: many wait for fixed times, on top of what the machine needs.
TIMEOUT = 900.0
#: How often a suite runs whose verdicts differ: those of ROS have time limits of their own.
ATTEMPTS = 3

Verdicts = Dict[str, str]  # "ok", or why not, by the names of suite and test


def checkout(variable: str) -> Path:
    """The folder that an environment variable names; without it the test is skipped."""
    path = os.environ.get(variable, "")
    if not path:
        pytest.skip(f"{variable} names no checkout")
    return Path(path)


class Suites:
    """Suites of packages in a workspace on top of DyKnow's."""

    def __init__(self, folder: Path, packages: Sequence[Path], targets: Sequence[str]) -> None:
        """Copy the packages, and build them if there are targets for that."""
        self._workspace = Workspace(folder / "ws", upon=[ROOT / "build/ws/devel"])
        self.source = self._workspace.folder / "src"
        self._results = folder / "results"
        for package in packages:
            self._workspace.add_copy(package.name, package)
        for target in targets:
            self._workspace.make(target, "-DCATKIN_ENABLE_TESTING=ON")
        space = self._workspace.folder if targets else ROOT / "build/ws"
        self._setup = space / "devel/setup.sh"

    def differences(self, suite: Path) -> Verdicts:
        """Return why tests fail with live ports that pass without, each time that both run."""
        differing: Optional[Verdicts] = None
        for _ in range(ATTEMPTS):
            plain, live = self.run(suite, False), self.run(suite, True)
            assert plain, f"{suite} has no tests"
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
        return differing or {}

    def run(self, suite: Path, is_live: bool) -> Verdicts:
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
        return verdicts


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
