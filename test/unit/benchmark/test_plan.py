# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

from __future__ import annotations

import csv

from dyknow_benchmark import system
from dyknow_benchmark.main import main
from dyknow_benchmark.planning_libraries import LIBRARIES


def test_every_library_is_planned_over_for_every_sort_of_demand(tmp_path, capsys):
    assert main(["plan", "--transformations", "400", "--out", str(tmp_path)]) == 0
    with (tmp_path / "plan.csv").open(newline="") as file:
        rows = {(row["library"], row["demand"]): row for row in csv.DictReader(file)}
    assert {library for library, _ in rows} == set(LIBRARIES)
    assert {row["transformations"] for row in rows.values()} == {"400"}
    assert rows["deep", "ground"]["steps"] == "92"  # the last plan is for the 92nd of a chain
    assert int(rows["dense", "ground"]["steps"]) > 92
    assert int(rows["rules, three variables", "variable"]["steps"]) > 9
    assert int(rows["individuals with an ontology", "class"]["steps"]) > 9
    assert "400 transformations: slowest demand" in capsys.readouterr().out


def test_a_library_may_have_any_size(tmp_path):
    assert main(["plan", "--transformations", "1", "101"]) == 0


def test_a_target_that_is_not_met_fails_a_check(monkeypatch):
    monkeypatch.setattr(system, "_PLAN", -1.0)
    assert main(["plan", "--transformations", "1"]) == 0
    assert main(["plan", "--transformations", "1", "--check"]) == 1
