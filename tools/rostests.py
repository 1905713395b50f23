"""Runs rostest suites, each with a ROS master, a ROS home and a time limit of its own.

A suite is one process group of ours: it is asked to end, and then ended, by its id alone.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Sequence

IN_WORKSPACE = ("bash", str(Path(__file__).resolve().parent / "in-workspace.sh"))
SUITE_TIMEOUT = 240.0  # s
END_TIMEOUT = 20.0  # s, for the nodes of a suite to end after SIGINT
SUMMARY = re.compile(r"^ \* (TESTS|ERRORS|FAILURES): (\d+)", re.MULTILINE)


@dataclass(frozen=True)
class SuiteOutcome:
    """What a suite came to: its counts, its duration in s, and all it printed."""

    name: str
    passed: int
    failed: int
    duration: float
    output: str


def run_all(suites: Sequence[Path], results: Path, jobs: int) -> tuple[int, int]:
    """Runs the suites, at most `jobs` at a time, and prints a line for each.

    Before the line of a failing one stands what it printed.

    Returns:
        The numbers of tests passed and failed.
    """
    passed = failed = 0
    with ThreadPoolExecutor(max_workers=max(1, jobs)) as pool:
        for outcome in pool.map(lambda suite: run_suite(suite, results), suites):
            passed += outcome.passed
            failed += outcome.failed
            if outcome.failed:
                print(outcome.output.rstrip("\n"))
            word = "FAILED" if outcome.failed else "ok"
            print(
                f"  {word:7}{outcome.name:24}{outcome.duration:6.1f} s"
                f"  {outcome.passed} passed, {outcome.failed} failed"
            )
    return passed, failed


def run_suite(suite: Path, results: Path) -> SuiteOutcome:
    """Runs one suite in the built workspace."""
    home = results / "ros" / suite.stem
    home.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, "ROS_HOME": str(home), "QT_QPA_PLATFORM": "offscreen"}
    # No master but the one that rostest starts, on a free port of its choice.
    environment.pop("ROS_MASTER_URI", None)
    log = home / "output.txt"
    begin = time.monotonic()
    with log.open("wb") as output:
        process = subprocess.Popen(
            [*IN_WORKSPACE, "rostest", f"--results-base-dir={home}", str(suite)],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            code = process.wait(SUITE_TIMEOUT)
            late = ""
        except subprocess.TimeoutExpired:
            code = 1
            late = f"\n{suite.name}: stopped after {SUITE_TIMEOUT:.0f} s\n"
        finally:
            _end(process)
    text = log.read_text(errors="replace") + late
    passed, failed = _count(text, code)
    return SuiteOutcome(suite.stem, passed, failed, time.monotonic() - begin, text)


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ends a suite that still runs: SIGINT first, so that rostest ends its nodes."""
    if process.poll() is not None:
        return
    process.send_signal(signal.SIGINT)
    try:
        process.wait(END_TIMEOUT)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _count(text: str, code: int) -> tuple[int, int]:
    counts = {"TESTS": 0, "ERRORS": 0, "FAILURES": 0}
    for name, number in SUMMARY.findall(text):
        counts[name] += int(number)
    failed = min(counts["TESTS"], counts["ERRORS"] + counts["FAILURES"])
    passed = counts["TESTS"] - failed
    if failed == 0 and (code != 0 or passed == 0):
        failed = 1
    return passed, failed
