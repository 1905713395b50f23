# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

from __future__ import annotations

import pytest

from tools import performance


def test_the_page_stays_as_it_is_where_nothing_was_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(performance, "RESULTS", tmp_path)
    page = performance.PAGE.read_text()
    assert performance.MARKED.sub(performance.filled, page) == page


def test_the_targets_of_all_measurements_are_in_one_table(tmp_path, monkeypatch):
    monkeypatch.setattr(performance, "RESULTS", tmp_path)
    for name in ("images", "chain"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "targets.csv").write_text(f"what,met\nof {name},met\n")
    text = "<!-- begin every/targets -->\nold\n<!-- end -->"
    assert performance.MARKED.sub(performance.filled, text).splitlines()[1:-2] == [
        "",
        "| measurement | what | met |",
        "| --- | --- | --- |",
        "| `chain` | of chain | met |",
        "| `images` | of images | met |",
    ]


@pytest.mark.parametrize(
    ("mark", "results", "table"),
    [
        pytest.param(
            "images/images p99_us payload",
            "payload,hops,p99_us\ntime,50,1.5\n",
            ["| p99 us | payload |", "| --- | --- |", "| 1.5 | time |"],
            id="of the columns that the mark names",
        ),
        pytest.param(
            "chain/figure4 kind hops mean_us",
            "kind,hops,mean_us\na,1,500\na,2,1500\n",
            ["| mean (ms) | 1 | 2 |", "| --- | --- | --- |", "| `a` | 0.500 | 1.500 |"],
            id="crossed",
        ),
    ],
)
def test_a_table_is_made_of_a_file(mark, results, table, tmp_path, monkeypatch):
    monkeypatch.setattr(performance, "RESULTS", tmp_path)
    file = tmp_path / f"{mark.split()[0]}.csv"
    file.parent.mkdir()
    file.write_text(results)
    text = f"<!-- begin {mark} -->\nold\n<!-- end -->"
    assert performance.MARKED.sub(performance.filled, text).splitlines()[2:-2] == table
