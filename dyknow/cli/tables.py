# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Text in columns."""

from __future__ import annotations

from typing import List, Sequence


def columns(rows: Sequence[Sequence[str]], right: Sequence[int] = ()) -> List[str]:
    """Align rows of cells.

    Args:
        rows: cells; every row has the same number.
        right: columns that are aligned right, such as numbers.

    Returns:
        A line for each row.
    """
    if not rows:
        return []
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(
            cell.rjust(width) if column in right else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths))
        ).rstrip()
        for row in rows
    ]


def count(number: int, thing: str) -> str:
    """Write a count: `1 nodelet`, `2 nodelets`."""
    return f"{number} {thing}" + ("" if number == 1 else "s")
