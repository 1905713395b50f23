# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The results of a measurement: tables, pictures and verdicts, shown and written in one way."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Callable, List, Sequence, Tuple

from dyknow_benchmark import machine, targets
from dyknow_benchmark.tables import Cell, render, write
from dyknow_benchmark.targets import Verdict


@dataclass(frozen=True)
class ResultTable:
    """Rows that are shown under a title and written to ``NAME.csv``."""

    name: str
    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]


@dataclass
class Results:
    """Results of one measurement, in the order in which they are shown.

    Attributes:
        machine: rows of the machine's table, which is the last one.
        verdicts: the targets that apply.
        tables: what was measured.
        pictures: names, and what draws them into a file.
    """

    machine: Sequence[Tuple[str, Cell]]
    verdicts: Sequence[Verdict] = ()
    tables: List[ResultTable] = field(default_factory=list)
    pictures: List[Tuple[str, Callable[[Path], None]]] = field(default_factory=list)

    @property
    def met(self) -> bool:
        """Whether every target that applies is reached."""
        return all(verdict.met for verdict in self.verdicts)

    def table(
        self, name: str, title: str, header: Sequence[str], rows: Sequence[Sequence[Cell]]
    ) -> None:
        """Add a table."""
        self.tables.append(ResultTable(name, title, header, rows))

    def draw(self, name: str, draw: Callable[[Path], None]) -> None:
        """Add a picture, written as PNG and SVG."""
        self.pictures.append((name, draw))

    def show(self) -> str:
        """Lay everything out for the terminal."""
        parts = [f"{each.title}\n{render(each.header, each.rows)}" for each in self._all_tables()]
        parts.append(f"targets\n{targets.show(self.verdicts)}")
        return "\n\n".join(parts)

    def write(self, directory: Path) -> List[Path]:
        """Write all files into a directory, which is made if need be; returns their paths."""
        directory.mkdir(parents=True, exist_ok=True)
        written = []
        verdicts = [verdict.row for verdict in self.verdicts]
        for each in [*self._all_tables(), ResultTable("targets", "", targets.HEADER, verdicts)]:
            path = directory / f"{each.name}.csv"
            write(path, each.header, each.rows)
            written.append(path)
        for name, draw in self.pictures:
            for suffix in (".png", ".svg"):
                path = directory / (name + suffix)
                draw(path)
                written.append(path)
        return written

    def _all_tables(self) -> List[ResultTable]:
        return [*self.tables, ResultTable("machine", "the machine", machine.HEADER, self.machine)]


def obstacle(directory: Path) -> str:
    """Return why files cannot be written into a directory; empty if they can."""
    there = next(each for each in (directory, *directory.parents) if each.exists())
    if not there.is_dir():
        return f"{there} is not a folder"
    if not os.access(there, os.W_OK | os.X_OK):
        return f"no permission to write into {there}"
    return ""
