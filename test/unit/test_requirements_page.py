# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tests and benchmarks that the page on the paper's requirements names are there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from dyknow_benchmark.main import MEASUREMENTS

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "doc" / "requirements.rst").read_text()
UNIT_TESTS = sorted(set(re.findall(r"``(unit/[\w/.]+)``", PAGE)))
SUITES = sorted(set(re.findall(r"``([\w/]+\.test)``", PAGE)))
BENCHMARKS = sorted(set(re.findall(r"``benchmark (\w+)``", PAGE)))


@pytest.mark.parametrize("path", [f"test/{each}" for each in UNIT_TESTS])
def test_a_unit_test_is_there(path):
    assert (ROOT / path).exists()


@pytest.mark.parametrize("path", [f"test/ros/{each}" for each in SUITES])
def test_a_suite_is_there(path):
    assert (ROOT / path).exists()


@pytest.mark.parametrize("name", BENCHMARKS)
def test_a_benchmark_is_there(name):
    assert name in MEASUREMENTS
