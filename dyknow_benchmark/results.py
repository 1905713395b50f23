# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The results of a measurement: statistics, tables, verdicts, shown and written in one way."""

from __future__ import annotations

import csv
import math
import os
import platform
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Callable, NamedTuple, Sequence, Union

import psutil

Cell = Union[str, int, float]
Row = Sequence[Cell]
Rows = Sequence[Row]

#: Columns of ``Summary.arrivals``, for latencies in us.
ARRIVALS = ("messages", "lost", "mean_us", "median_us", "p99_us", "max_us")
#: Columns of ``Summary.spread``, for times in ms.
SPREAD = ("mean_ms", "median_ms", "p99_ms", "max_ms")


@dataclass(frozen=True)
class Summary:
    """Times of some events, in the unit they were measured in; zero when there are none.

    ``p99`` is the smallest value that at least 99 % do not exceed.
    """

    count: int = 0
    mean: float = 0.0
    median: float = 0.0
    p99: float = 0.0
    max: float = 0.0

    @classmethod
    def of(cls, values: Sequence[float]) -> Summary:
        """Sum up values in any order."""
        if not values:
            return cls()
        ordered = sorted(values)
        count = len(ordered)
        p99 = ordered[math.ceil(0.99 * count) - 1]
        return cls(count, math.fsum(ordered) / count, median(ordered), p99, ordered[-1])

    @property
    def spread(self) -> tuple[float, ...]:
        """Cells under ``SPREAD``."""
        return (self.mean, self.median, self.p99, self.max)

    def arrivals(self, sent: int) -> tuple[float, ...]:
        """Cells under ``ARRIVALS``, where these are the latencies of messages that were sent."""
        return (self.count, sent - self.count, *self.spread)


def median_interval(values: Sequence[float]) -> tuple[float, float]:
    """Bounds between which the true median lies with a probability of at least 95 %.

    They are two of the values themselves, found by the binomial distribution of how many values
    fall below the median; nothing is assumed of how the values are distributed. With less than
    six values there are no such bounds, and the extremes are returned.
    """
    ordered = sorted(values)
    count = len(ordered)
    rank, at_most, log_ways = 0, 0.0, 0.0
    # at_most: probability that at most k of the values lie below the median.
    for k in range(count // 2):
        at_most += math.exp(log_ways - count * math.log(2))
        if at_most > 0.025:
            break
        rank = k
        log_ways += math.log((count - k) / (k + 1))
    return ordered[rank], ordered[count - 1 - rank]


class Verdict(NamedTuple):
    """One quantity, with its unit if it has one, beside its target."""

    what: str
    measured: float
    limit: float
    at_least: bool = False

    @property
    def met(self) -> bool:
        """Whether the target is reached."""
        return self.measured >= self.limit if self.at_least else self.measured <= self.limit

    @property
    def row(self) -> Sequence[Cell]:
        """A row of the table of targets."""
        sign = ">=" if self.at_least else "<="
        met = "met" if self.met else "NOT met"
        return (self.what, self.measured, f"{sign} {self.limit:g}", met)


class ResultTable(NamedTuple):
    """Rows that are shown under a title and written to ``NAME.csv``."""

    name: str
    title: str
    header: Sequence[str]
    rows: Rows


class Results:
    """Results of one measurement, in the order in which they are shown.

    Attributes:
        verdicts: the targets that apply.
        tables: the measured quantities.
        pictures: names, and functions that draw them into a file.
    """

    def __init__(self) -> None:
        """Note the load of the machine, which is shown for the time from now on."""
        self.verdicts: list[Verdict] = []
        self.tables: list[ResultTable] = []
        self.pictures: list[tuple[str, Callable[[Path], None]]] = []
        psutil.cpu_percent()
        self._load_average = os.getloadavg()[0]
        self._machine: Rows = ()

    def end(self) -> Results:
        """Note the load until now."""
        self._machine = (
            ("processor", _processor()),
            ("cores", os.cpu_count() or 0),
            ("python", platform.python_version()),
            ("system", platform.platform()),
            ("load_average_before", self._load_average),
            ("load_average_after", os.getloadavg()[0]),
            ("busy_percent", float(psutil.cpu_percent())),
        )
        return self

    @property
    def met(self) -> bool:
        """Whether every target that applies is reached."""
        return all(verdict.met for verdict in self.verdicts)

    def table(self, name: str, title: str, header: Sequence[str], rows: Rows) -> None:
        """Add a table."""
        self.tables.append(ResultTable(name, title, header, list(rows)))

    def verdict(self, what: str, measured: float, limit: float, at_least: bool = False) -> None:
        """Add a target that applies."""
        self.verdicts.append(Verdict(what, measured, limit, at_least))

    def show(self) -> str:
        """Lay everything out for the terminal."""
        *tables, targets = self._all_tables()
        parts = [f"{each.title}\n{render(each.header, each.rows)}" for each in tables]
        shown = render(targets.header, targets.rows)
        parts.append(
            f"targets\n{shown if targets.rows else 'no target applies to what was measured'}"
        )
        return "\n\n".join(parts)

    def write(self, directory: Path) -> list[Path]:
        """Write all files into a directory, which is made if need be; returns their paths."""
        directory.mkdir(parents=True, exist_ok=True)
        written = []
        for each in self._all_tables():
            written.append(directory / f"{each.name}.csv")
            with written[-1].open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(each.header)
                writer.writerows([_text(cell) for cell in row] for row in each.rows)
        for name, draw in self.pictures:
            for suffix in (".png", ".svg"):
                written.append(directory / (name + suffix))
                draw(written[-1])
        return written

    def _all_tables(self) -> list[ResultTable]:
        targets = [verdict.row for verdict in self.verdicts]
        return [
            *self.tables,
            ResultTable("machine", "the machine", ("what", "value"), self._machine),
            ResultTable("targets", "targets", ("what", "measured", "target", "met"), targets),
        ]


def render(header: Sequence[str], rows: Rows) -> str:
    """Lay rows out in columns: text to the left, numbers to the right."""
    texts = [list(header)] + [[_text(cell) for cell in row] for row in rows]
    widths = [max(len(line[column]) for line in texts) for column in range(len(header))]
    texts.insert(1, ["-" * width for width in widths])
    is_number = [
        bool(rows) and not any(isinstance(row[column], str) for row in rows)
        for column in range(len(header))
    ]
    lines = [
        [f"{cell:{'>' if right else '<'}{width}}" for cell, width, right in zip(*line)]
        for line in ((text, widths, is_number) for text in texts)
    ]
    return "\n".join("  ".join(line).rstrip() for line in lines)


def obstacle(directory: Path) -> str:
    """Return why files cannot be written into a directory; empty if they can."""
    there = next(each for each in (directory, *directory.parents) if each.exists())
    if not there.is_dir():
        return f"{there} is not a folder"
    if not os.access(there, os.W_OK | os.X_OK):
        return f"no permission to write into {there}"
    return ""


def _text(cell: Cell) -> str:
    if isinstance(cell, float):
        return f"{cell:.3f}" if abs(cell) < 100 else f"{cell:.1f}"
    return str(cell)


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())
