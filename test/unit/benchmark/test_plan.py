# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

from __future__ import annotations

import csv

from dyknow_benchmark import plan
from dyknow_benchmark.main import main


def test_both_libraries_are_planned_over(tmp_path, capsys):
    assert main(["plan", "--transformations", "400", "--out", str(tmp_path)]) == 0
    with (tmp_path / "plan.csv").open(newline="") as file:
        deep, dense = csv.DictReader(file)
    assert (deep["library"], deep["transformations"]) == ("deep", "400")
    assert (dense["library"], dense["transformations"]) == ("dense", "400")
    assert int(deep["steps"]) == 92  # the last plan is for the 92nd of a chain
    assert int(dense["steps"]) > 92
    assert "plan, median" in capsys.readouterr().out


def test_a_library_of_any_size_has_a_plan(tmp_path):
    for count in (1, 3, 101):
        assert main(["plan", "--transformations", str(count)]) == 0


def test_a_target_that_is_not_met_fails_a_check(monkeypatch):
    monkeypatch.setattr(plan, "_measure", lambda library: (1, 3.0, [1.0]))
    assert main(["plan", "--transformations", "1"]) == 0
    assert main(["plan", "--transformations", "1", "--check"]) == 1
