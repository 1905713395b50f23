# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Runs rostest suites, each with a ROS master, a ROS home and a time limit of its own.

Where that is allowed (to root, mostly), each has a network of its own as well.
"""

from __future__ import annotations

import re
import shutil
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Mapping, Sequence

from processes import own_network, run_logged
from reports import read_report

IN_WORKSPACE = ("bash", str(Path(__file__).resolve().parent / "in-workspace.sh"))
SUITE_TIMEOUT = 960.0  # s
#: Suites that take half a minute or longer, the longest first.
SLOW = """hosts streams scripts images manager nodelet_manager manager_faults dyknow_command nodes
    examples rewiring new_master demo start security rqt_window formulas bus launch
    node_handle""".split()
#: What each test that is skipped prints: rostest counts it as passed.
SKIPPED = re.compile(r"^skipped: (.*)", re.MULTILINE)


@dataclass(frozen=True)
class SuiteOutcome:
    """What a suite came to: what failed, what it skipped, its duration in s, all it printed."""

    name: str
    passed: int
    failures: tuple[str, ...]
    skipped: str
    duration: float
    output: str


def run_all(
    suites: Sequence[Path],
    results: Path,
    jobs: int,
    timeout: float,
    environment: Mapping[str, str],
) -> tuple[int, tuple[str, ...]]:
    """Runs the suites, at most `jobs` at a time and `timeout` s each, and prints a line for each.

    The slowest ones come first, so that none is left alone at the end. Before the line of a
    failing one stands what it printed. Returns the number of tests passed, and a line for each
    that failed.
    """
    passed = 0
    failures: list[str] = []
    network = own_network()
    with ThreadPoolExecutor(max_workers=max(1, jobs)) as pool:
        runs = [
            pool.submit(run_suite, suite, results, timeout, network, environment)
            for suite in sorted(suites, key=lambda suite: _turn(suite.stem))
        ]
        for run in as_completed(runs):
            outcome = run.result()
            passed += outcome.passed
            failures += [f"{outcome.name}: {failure}" for failure in outcome.failures]
            if outcome.failures:
                print(outcome.output.rstrip("\n"))
            word = "FAILED" if outcome.failures else "ok"
            print(
                f"  {word:7}{outcome.name:24}{outcome.duration:6.1f} s"
                f"  {outcome.passed} passed, {len(outcome.failures)} failed{outcome.skipped}"
            )
    return passed, tuple(failures)


def _turn(suite: str) -> int:
    return SLOW.index(suite) if suite in SLOW else len(SLOW)


def run_suite(
    suite: Path,
    results: Path,
    timeout: float,
    network: tuple[str, ...],
    environment: Mapping[str, str],
) -> SuiteOutcome:
    """Runs one suite in the built workspace, below a command that gives it a network."""
    home = results / "ros" / suite.stem
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir(parents=True)
    log = home / "output.txt"
    begin = time.monotonic()
    code = run_logged(
        [*network, *IN_WORKSPACE, "rostest", f"--results-base-dir={home}", str(suite)],
        log,
        timeout,
        {"ROS_HOME": str(home), "QT_QPA_PLATFORM": "offscreen", **environment},
    )
    text = log.read_text(errors="replace")
    reports = [read_report(path) for path in sorted(home.glob("*/rosunit-*.xml"))]
    printed = "".join(report.printed for report in reports)
    reasons = SKIPPED.findall(printed)
    passed = sum(report.passed for report in reports) - len(reasons)
    skipped = f", {len(reasons)} skipped: {', '.join(sorted(set(reasons)))}" if reasons else ""
    failures = tuple(failure for report in reports for failure in report.failures)
    if not failures and (code != 0 or passed + len(reasons) == 0):
        failures = (f"exit code {code}",)
    duration = time.monotonic() - begin
    return SuiteOutcome(suite.stem, passed, failures, skipped, duration, text + printed)
