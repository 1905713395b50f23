# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What the suites are told of a process that they wait for in vain."""

from __future__ import annotations

import sys

import pytest
from ros import processes
from ros.processes import Running, eventually


@pytest.fixture(autouse=True)
def _impatient(monkeypatch):
    monkeypatch.setattr(processes, "LEAST", 0.01)


def test_a_failure_shows_what_is_there_by_then():
    looks = []
    with pytest.raises(AssertionError, match=r"^not within 0.2 s: it holds\n[1-9]\d* looks$"):
        eventually(lambda: looks.append(1), 0.01, "it holds", lambda: f"{len(looks)} looks")


def test_a_process_that_says_something_else_and_runs_on():
    script = "import time; print('something else'); time.sleep(1000)"
    with Running(sys.executable, "-c", script) as process:
        process.wait_for("something else")
        with pytest.raises(AssertionError, match=r"(?s)runs on; it said:\nsomething else"):
            process.wait_for("the word", 0.01)


def test_a_process_that_says_something_else_and_ends():
    script = "print('something else'); raise SystemExit(3)"
    says = pytest.raises(AssertionError, match=r"(?s)code 3; it said:\nsomething else")
    with Running(sys.executable, "-c", script) as process, says:
        process.wait_for("the word")
