# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Runs the checks and tests of the repository, and sums up.

A stage that fails fails the run, but the later stages still run, so that one run shows everything
there is to mend. The build occupies one processor for a part of its time, and the rostest suites
wait for much of theirs: the other checks and tests run beside them, one after the other.

With ``--long`` it runs what takes too long for every change instead: the unit tests that are
marked ``long``, those on Python 3.8, the others with random examples, all quick tests with random
delays of threads, the rostest suites in ``test/ros/long`` (one with our C++ built with
sanitizers), the types of the tests, and the measurement of what the unit tests cover.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Callable, Tuple

import rostests
from processes import run_logged
from reports import read_report

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "build" / "test-results"
VENV = ROOT / "build" / "venv" / "bin"
IN_WORKSPACE = ("bash", str(ROOT / "tools" / "in-workspace.sh"))
ROS_PYTHON = "/usr/bin/python3"
STAGE_TIMEOUT = 3000.0  # s
LONG_TIMEOUT = 3600.0  # s, for a stage or suite of the long run
IN_PARALLEL = ("-n", "3", "--dist", "worksteal")  # some wait for processes or windows
USES_LIBRARIES = ("dyknow_cpp_test_libraries", "dyknow_cpp_test_node")
#: Lists the source files without SPDX lines; those to be copied or shown line by line need none.
LACKING_SPDX = (
    "git grep --no-index --exclude-standard -L 'SPDX-License-Identifier: BSD-3-Clause' -- "
    "scripts '*.py' '*.cpp' '*.h' '*.sh' '*.bash' '*.cmake' '*.in' '*CMakeLists.txt' Makefile "
    "':!examples/convert' ':!examples/skeleton' ':!examples/two_cameras' ':!build'"
)
SYSTEM_MODULES = "/usr/lib/python3/dist-packages"
LAYERS_WITHOUT_ROS = ("model", "formulas", "nodelet", "proxy", "manager")


@dataclass(frozen=True)
class Outcome:
    """What a stage came to: counts of checks or tests, what to print, or why it was skipped.

    For each test that failed, `failures` has a line, which is printed at the end.
    """

    passed: int
    failed: int
    output: str = ""
    note: str = ""
    failures: tuple[str, ...] = ()


def run_command(*argv: str, timeout: float = STAGE_TIMEOUT, **environment: str) -> tuple[int, str]:
    """Runs a command; returns its exit code and all it printed."""
    code = run_logged(argv, stage_log(), timeout, environment)
    return code, stage_log().read_text(errors="replace")


def stage_log() -> Path:
    """The output of the last command of this thread's stage: stages run beside one another."""
    return RESULTS / f"{threading.current_thread().name}.txt"


def check(*argv: str) -> Callable[[], Outcome]:
    """A stage that is one check, passed when the command ends with 0."""

    def stage() -> Outcome:
        code, output = run_command(*argv)
        return Outcome(1, 0) if code == 0 else Outcome(0, 1, output)

    return stage


def sanitized(sanitizer: str) -> Callable[[], Outcome]:
    """A stage that builds our C++ with a sanitizer, in a workspace of its own."""
    words = (f"ws-{sanitizer}", "cpp_nodelet_manager", "dyknow_cpp_test")
    return check("bash", "tools/build.sh", *words, f"-DDYKNOW_SANITIZER={sanitizer}")


def run_pytest(
    results: str, *argv: str, timeout: float = STAGE_TIMEOUT, **environment: str
) -> Outcome:
    """Runs pytest by the given command and counts its tests."""
    path = RESULTS / results
    path.unlink(missing_ok=True)
    code, output = run_command(*argv, f"--junit-xml={path}", timeout=timeout, **environment)
    report = read_report(path)
    failed = len(report.failures)
    if report.passed + failed + report.skipped == 0:
        return Outcome(0, 1, output, "no tests found" if code in (0, 4, 5) else "")
    note = f"{report.passed} passed, {failed} failed"
    note += f", {report.skipped} skipped" if report.skipped else ""
    if code == 0:
        return Outcome(report.passed, failed, "", note, report.failures)
    return Outcome(report.passed, max(failed, 1), output, note, report.failures)


def unit_tests(marked: str = "not long", is_long: bool = False, **environment: str) -> Outcome:
    """The tests that need no roscore, on the Python of ROS: those that are marked so."""
    return run_pytest(
        f"unit-{marked.replace(' ', '-')}.xml",
        *IN_WORKSPACE,
        *(str(VENV / "python"), "-m", "pytest", "-q", *IN_PARALLEL),
        *("-m", marked, "test/unit"),
        # Stacks that are taken of a running test, rather than a stuck one, may crash it.
        *(("-o", "faulthandler_timeout=0") if is_long else ()),
        timeout=LONG_TIMEOUT if is_long else STAGE_TIMEOUT,
        QT_QPA_PLATFORM="offscreen",
        **environment,
    )


def unit_tests_py38() -> Outcome:
    """The unit tests on a real Python 3.8, the oldest supported, with rospy of this machine.

    The window's need its Qt, and builds of catkin workspaces its own Python.
    """
    python = find_python38()
    if python is None:
        return Outcome(0, 0, note="skipped: there is no Python 3.8 on this machine")
    code, output = run_command(
        "bash", "tools/venv.sh", "venv38", python, "tools/requirements-py38.txt"
    )
    if code != 0:
        return Outcome(0, 1, output)
    venv = ROOT / "build" / "venv38"
    # Modules of ROS in pure Python; before them those of the virtual environment are found.
    (venv / "lib/python3.8/site-packages/system.pth").write_text(f"{SYSTEM_MODULES}\n")
    argv = (str(venv / "bin" / "python"), "-m", "pytest", "-q", *IN_PARALLEL, "-m", "not long")
    left_out = [f"--ignore=test/unit/{folder}" for folder in ("packaging", "rqt")]
    test = "cli/test_interruptible.py::test_no_module_is_loaded_while_sigint_raises"
    left_out.append(f"--deselect=test/unit/{test}[dyknow_rqt]")
    return run_pytest(
        "unit-py38.xml",
        *(*IN_WORKSPACE, *argv, *left_out, "test/unit"),
        timeout=LONG_TIMEOUT,
        HYPOTHESIS_PROFILE="slow",
        PYTEST_ADDOPTS="-p no:pytest-qt",  # the system's is for its own Python
    )


def coverage() -> Outcome:
    """The share of lines and branches of the layers without ROS that their unit tests reach."""
    argv = ("venv-coverage", ROS_PYTHON, "tools/requirements-coverage.txt")
    code, output = run_command("bash", "tools/venv.sh", *argv, "--system-site-packages")
    if code != 0:
        return Outcome(0, 1, output)
    outcome = run_pytest(
        "unit-coverage.xml",
        *IN_WORKSPACE,
        *(str(ROOT / "build/venv-coverage/bin/python"), "-m", "pytest", "-q", *IN_PARALLEL),
        *("-m", "not long", *(f"test/unit/{layer}" for layer in LAYERS_WITHOUT_ROS), "--cov"),
        timeout=LONG_TIMEOUT,
        HYPOTHESIS_PROFILE="slow",
        COVERAGE_FILE=str(RESULTS / "coverage"),
    )
    total = re.search(r"^TOTAL .* (\S+%)$", stage_log().read_text(errors="replace"), re.MULTILINE)
    return replace(outcome, note=f"{outcome.note}, {total.group(1)} covered" if total else "")


def find_python38() -> str | None:
    """The path of a Python 3.8 that runs: the one on PATH, or one that pyenv has installed."""
    pyenv_roots = [Path(os.environ["PYENV_ROOT"])] if "PYENV_ROOT" in os.environ else []
    pyenv_roots.append(Path.home() / ".pyenv")
    installed = [
        str(python)
        for root in pyenv_roots
        for python in sorted(root.glob("versions/3.8.*/bin/python3.8"))
    ]
    question = "import sys, venv; print(sys.executable if sys.version_info[:2] == (3, 8) else '')"
    for candidate in ["python3.8", *installed]:
        # A shim of pyenv is on PATH even where it cannot run: only running it tells.
        code, output = run_command(candidate, "-c", question)
        if code == 0 and output.strip():
            return output.strip()
    return None


def ros_tests(folder: str = "", timeout: float = LONG_TIMEOUT, **environment: str) -> Outcome:
    """The rostest suites in a folder of ``test/ros``."""
    suites = sorted((ROOT / "test" / "ros" / folder).glob("*.test"))
    if not suites:
        return Outcome(0, 1, note="no tests found")
    passed, failures = rostests.run_all(
        suites,
        RESULTS,
        jobs=int(os.environ.get("ROSTEST_JOBS", "7")),
        timeout=timeout,
        environment=environment,
    )
    failed = len(failures)
    return Outcome(passed, failed, "", f"{passed} passed, {failed} failed", failures)


Stage = Tuple[str, Callable[[], Outcome]]

BUILD: Stage = ("build", check("make", "--no-print-directory", "build"))
TOOLS: Stage = ("check tools", check("make", "--no-print-directory", "venv"))
ROS_TESTS: Stage = ("ROS tests", lambda: ros_tests(timeout=rostests.SUITE_TIMEOUT))
#: Run beside the build.
CHECKS: tuple[Stage, ...] = (
    TOOLS,
    ("SPDX lines", check("sh", "-c", f"! {LACKING_SPDX}")),
    ("ruff check", check(str(VENV / "ruff"), "check")),
    ("ruff format", check(str(VENV / "ruff"), "format", "--check")),
    ("mypy", check(str(VENV / "mypy"))),
    ("lint-imports", check(str(VENV / "lint-imports"))),
    ("codespell", check(str(VENV / "codespell"))),
    ("docs", check("make", "--no-print-directory", "docs")),
)
#: Run beside the ROS tests.
BUILT: tuple[Stage, ...] = (
    (
        "catkin_lint",
        check("catkin_lint", "-W2", "--strict", "--ignore", "subproject", "build/ws/src/dyknow"),
    ),
    ("unit tests", unit_tests),
)

LONG_STAGES: tuple[Stage, ...] = (
    BUILD,
    TOOLS,
    ("build what uses libraries", check("bash", "tools/build.sh", "ws", *USES_LIBRARIES)),
    ("build with the address sanitizer", sanitized("address")),
    ("build with the thread sanitizer", sanitized("thread")),
    ("mypy on tests", check(str(VENV / "mypy"), "--config-file", "test/mypy.ini")),
    ("unit tests on Python 3.8", unit_tests_py38),
    ("coverage", coverage),
    ("unit tests with delays", lambda: unit_tests(is_long=True, DYKNOW_DELAYS="1")),
    ("random unit tests", lambda: unit_tests(is_long=True, HYPOTHESIS_PROFILE="random")),
    ("long unit tests", lambda: unit_tests("long", True)),
    ("ROS tests with delays", lambda: ros_tests(PYTHONPATH=str(ROOT / "test" / "delayed"))),
    ("long ROS tests", lambda: ros_tests("long")),
)


def main() -> int:
    """Runs the stages; returns 0 when none of them failed."""
    parser = argparse.ArgumentParser(description="Run the checks and tests of the repository.")
    parser.add_argument("--long", action="store_true", help="run the long tests instead")
    is_long = parser.parse_args().long
    os.environ["PATH"] = "/usr/bin:" + os.environ["PATH"]
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's ``&`` ignores it
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    os.chdir(ROOT)
    RESULTS.mkdir(parents=True, exist_ok=True)
    begin = time.monotonic()
    if is_long:
        outcomes = [run_stage(*stage) for stage in LONG_STAGES]
    else:
        with ThreadPoolExecutor(1, "beside") as pool:
            build, tests = [pool.submit(run_stage, *stage) for stage in (BUILD, ROS_TESTS)]
            outcomes = [run_stage(*stage) for stage in CHECKS]
            outcomes.append(build.result())
            outcomes += [run_stage(*stage) for stage in BUILT]
            outcomes.append(tests.result())
    print(f"\n{time.monotonic() - begin:.1f} s in all")
    bad = [(name, outcome) for name, outcome in outcomes if outcome.failed]
    if bad:
        print(f"failed: {', '.join(name for name, _ in bad)}")
        failures = [failure for _, outcome in bad for failure in outcome.failures]
        print("".join(f"  {failure}\n" for failure in failures), end="")
    passed = sum(outcome.passed for _, outcome in outcomes)
    failed = sum(outcome.failed for _, outcome in outcomes)
    print(f"{passed} passed, {failed} failed")
    return 1 if failed else 0


def run_stage(name: str, stage: Callable[[], Outcome]) -> tuple[str, Outcome]:
    """Runs a stage and prints a line for it, after the output of one that failed."""
    started = time.monotonic()
    outcome = stage()
    if outcome.failed and outcome.output:
        print(outcome.output.rstrip("\n"))
    word = "FAILED" if outcome.failed else "ok"
    print(f"{word:7}{name:26}{time.monotonic() - started:6.1f} s  {outcome.note}".rstrip())
    return name, outcome


if __name__ == "__main__":
    sys.exit(main())
