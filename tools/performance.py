# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Measures what doc/performance.md shows, and writes the results into that page.

Without arguments everything is measured, which takes most of an hour; the machine should have
nothing else to do. Arguments choose: `chain`, `images`, ..., or `page` to measure nothing and
fill in what is there. Between the marks `<!-- begin MEASUREMENT/FILE COLUMN... -->` and
`<!-- end -->` of the page stand these columns of `FILE.csv` of the last run of that measurement
(all columns if none is named); with `every` for the measurement those of all that were run, one
below the other.
"""

from __future__ import annotations

import csv
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Callable, Sequence

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "build" / "benchmark"
PAGE = ROOT / "doc" / "performance.md"
PICTURES = ROOT / "doc" / "images"

#: What is run for each measurement of the page; it writes into a folder of that name.
COMMANDS: dict[str, Sequence[str]] = {
    name: (name,)
    for name in """chain fast_chain images busy outside shared rewire cpp scripts footprint model
    plan formulas recover failover window""".split()
}
COMMANDS["fast_chain"] = ("chain", "--rate", "100")
MARKED = re.compile(r"(<!-- begin (\w+)/(\w+)((?: \w+)*) -->\n)(.*?)(<!-- end -->)", re.DOTALL)


def main(names: Sequence[str]) -> int:
    """Measures what is named and fills the page in; returns an exit code."""
    unknown = sorted(set(names) - {*COMMANDS, "page"})
    if unknown:
        print(
            f"performance: no measurement {', '.join(unknown)}; there are: {', '.join(COMMANDS)}"
        )
        return 2
    # Other monitors of formulas are installed for the checks alone.
    installed = map(str, (ROOT / "build" / "venv" / "lib").glob("python3*/site-packages"))
    paths = ":".join([os.environ.get("PYTHONPATH", ""), *installed])
    environment = {**os.environ, "PYTHONPATH": paths}
    for name in [each for each in COMMANDS if not names or each in names]:
        command = ["rosrun", "dyknow", "benchmark", *COMMANDS[name], "--out", str(RESULTS / name)]
        print(" ".join(command), flush=True)
        if subprocess.run(command, check=False, env=environment).returncode:
            return 1
    PAGE.write_text(MARKED.sub(filled, PAGE.read_text()))
    for picture in (RESULTS / "chain").glob("figure4.*g"):
        shutil.copyfile(picture, PICTURES / picture.name)
    return 0


def filled(mark: re.Match[str]) -> str:
    """The marked part of the page with the last results, or unchanged where there are none."""
    begin, measurement, file, columns, present, end = mark.groups()
    if measurement == "every":
        header, rows = every(file, present)
        if not rows:
            return mark[0]
    elif (path := RESULTS / measurement / f"{file}.csv").exists():
        header, *rows = read(path)
    else:
        return mark[0]
    if columns:
        chosen = [header.index(name) for name in columns.split()]
        header, *rows = [[line[index] for index in chosen] for line in (header, *rows)]
    shape = SHAPES.get(file, as_it_is)
    return f"{begin}\n{shape(header, rows)}\n\n{end}"


def read(path: Path) -> list[list[str]]:
    """The lines of a table."""
    with path.open(newline="") as lines:
        return list(csv.reader(lines))


def every(file: str, present: str) -> tuple[list[str], list[list[str]]]:
    """The tables of that name of all measurements as one, with a column for the measurement.

    Of a measurement that was not run, the lines are those that are present.
    """
    header: list[str] = []
    rows = []
    for name in COMMANDS:
        path = RESULTS / name / f"{file}.csv"
        if path.exists():
            header, *found = read(path)
            rows += [[f"`{name}`", *row] for row in found]
        else:
            rows += [row for row in cells(present) if row[0] == f"`{name}`"]
    return ["measurement", *header], rows if header else []


def cells(text: str) -> list[list[str]]:
    """The lines of a table in Markdown."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lays rows out in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def as_it_is(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """All columns, under their names in the file."""
    return table([name.replace("_", " ") for name in header], rows)


def crossed(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """The third column in ms, as a line for each value of the first, over those of the second."""
    times = {(row[0], row[1]): f"{float(row[2]) / 1000:.3f}" for row in rows}
    names, columns = (list(dict.fromkeys(row[index] for row in rows)) for index in (0, 1))
    lines = [[f"`{name}`", *(times[name, each] for each in columns)] for name in names]
    return table([header[2].replace("_us", " (ms)"), *columns], lines)


def in_a_sentence(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """The machine and its load."""
    of = {row[0]: row[1] for row in rows}
    return (
        f"Measured on: {of['processor']}, {of['cores']} cores, Python {of['python']}, "
        f"{of['system']}; load average {float(of['load_average_before']):.1f} before and "
        f"{float(of['load_average_after']):.1f} after, {float(of['busy_percent']):.0f} % busy."
    )


SHAPES: dict[str, Callable[[Sequence[str], Sequence[Sequence[str]]], str]] = {
    "figure4": crossed,
    "machine": in_a_sentence,
    "shared": crossed,
}

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
