# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reports that the run of all tests reads from the result files of pytest and rosunit."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tools.reports import Report, read_report

PYTEST_FILE = """
import pytest

def test_that_passes(): pass
def test_that_fails(): assert 1 == 2, "one is not two"
@pytest.mark.skip(reason="not here")
def test_that_is_skipped(): pass
@pytest.fixture
def broken(): raise OSError("no such thing")
def test_with_an_error(broken): pass
"""
ROSUNIT_FILE = """
import unittest

class SomeTest(unittest.TestCase):
    def test_that_passes(self): print("spawned")
    def test_that_fails(self): self.assertEqual(1, 2)

if __name__ == "__main__":
    import rosunit
    rosunit.unitrun("dyknow", "some", SomeTest)
"""


def test_a_result_file_of_pytest(tmp_path):
    source, path = tmp_path / "test_some.py", tmp_path / "results.xml"
    source.write_text(PYTEST_FILE)
    command = [sys.executable, "-m", "pytest", "-q", f"--junit-xml={path}", str(source)]
    assert subprocess.run(command, capture_output=True, cwd=tmp_path, check=False).returncode == 1
    report = read_report(path)
    assert (report.passed, report.skipped) == (1, 1)
    first, second = sorted(report.failures)
    assert first.startswith("test_that_fails: AssertionError: one is not two")
    assert second.startswith("test_with_an_error: ") and "no such thing" in second


def test_a_result_file_of_rosunit(tmp_path):
    pytest.importorskip("rosunit")
    source, path = tmp_path / "test_some.py", tmp_path / "rosunit-some.xml"
    source.write_text(ROSUNIT_FILE)
    command = [sys.executable, str(source), f"--gtest_output=xml:{path}"]
    subprocess.run(command, capture_output=True, cwd=tmp_path, check=False)
    report = read_report(path)
    assert (report.passed, report.skipped) == (1, 0)
    assert report.failures == (
        "test_that_fails: test_some.py:6: def test_that_fails(self): self.assertEqual(1, 2)",
    )
    assert "rosunit-some, system-out:\nspawned\n" in report.printed


@pytest.mark.parametrize("content", [None, "", "<testsuite><testcase name='torn'"])
def test_a_file_that_is_missing_or_torn_reports_nothing(tmp_path, content):
    path = tmp_path / "results.xml"
    if content is not None:
        path.write_text(content)
    assert read_report(path) == Report()
