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
