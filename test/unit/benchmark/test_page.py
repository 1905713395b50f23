# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

from __future__ import annotations

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


def test_a_table_has_the_columns_that_its_mark_names(tmp_path, monkeypatch):
    monkeypatch.setattr(performance, "RESULTS", tmp_path)
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "images.csv").write_text("payload,hops,p99_us\ntime,50,1.5\n")
    text = "<!-- begin images/images p99_us payload -->\nold\n<!-- end -->"
    assert performance.MARKED.sub(performance.filled, text).splitlines()[2:-2] == [
        "| p99 us | payload |",
        "| --- | --- |",
        "| 1.5 | time |",
    ]


def test_a_table_is_crossed_where_a_file_has_a_line_for_each_pair(tmp_path, monkeypatch):
    monkeypatch.setattr(performance, "RESULTS", tmp_path)
    (tmp_path / "chain").mkdir()
    (tmp_path / "chain" / "figure4.csv").write_text("kind,hops,mean_us\na,1,500\na,2,1500\n")
    text = "<!-- begin chain/figure4 kind hops mean_us -->\nold\n<!-- end -->"
    assert performance.MARKED.sub(performance.filled, text).splitlines()[2:-2] == [
        "| mean (ms) | 1 | 2 |",
        "| --- | --- | --- |",
        "| `a` | 0.500 | 1.500 |",
    ]
