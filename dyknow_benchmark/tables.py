# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Rows of results, as a table on the terminal and as CSV."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import List, Sequence, Union

Cell = Union[str, int, float]


def render(header: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    """Lay rows out in columns: text to the left, numbers to the right."""
    texts = [list(header)] + [[_text(cell) for cell in row] for row in rows]
    widths = [max(len(line[column]) for line in texts) for column in range(len(header))]
    numeric = [
        bool(rows) and all(not isinstance(row[column], str) for row in rows)
        for column in range(len(header))
    ]
    lines = []
    for line in texts:
        cells = [
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(line, widths, numeric)
        ]
        lines.append("  ".join(cells).rstrip())
    lines.insert(1, "  ".join("-" * width for width in widths))
    return "\n".join(lines)


def write(path: Path, header: Sequence[str], rows: Sequence[Sequence[Cell]]) -> None:
    """Write a CSV file with one line of column names."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        lines: List[List[str]] = [[_text(cell) for cell in row] for row in rows]
        writer.writerows(lines)


def _text(cell: Cell) -> str:
    if isinstance(cell, float):
        return f"{cell:.3f}" if abs(cell) < 100 else f"{cell:.1f}"
    return str(cell)
