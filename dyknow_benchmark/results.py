# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The results of a measurement: statistics, tables, verdicts, shown and written in one way."""

from __future__ import annotations

import csv
import math
import os
import platform
from pathlib import Path
from statistics import median
from typing import Callable, NamedTuple, Sequence, Union

import psutil

from dyknow.cli.output import columns

Cell = Union[str, int, float]
Row = Sequence[Cell]
Rows = Sequence[Row]


def spread(unit: str) -> tuple[str, ...]:
    """Columns of ``Summary.spread``, for values in a unit."""
    return tuple(f"{each}_{unit}" for each in ("mean", "median", "p99", "max"))


#: Columns of ``Summary.arrivals``, for latencies in us.
ARRIVALS = ("messages", "lost", *spread("us"))


class Summary(NamedTuple):
    """Values in the unit they were measured in; nan when there are none, which meets no target.

    ``p99`` is the smallest value that at least 99 % do not exceed.
    """

    number: int = 0
    mean: float = math.nan
    median: float = math.nan
    p99: float = math.nan
    max: float = math.nan

    @classmethod
    def of(cls, values: Sequence[float]) -> Summary:
        if not values:
            return cls()
        ordered = sorted(values)
        count = len(ordered)
        p99 = ordered[math.ceil(0.99 * count) - 1]
        return cls(count, math.fsum(ordered) / count, median(ordered), p99, ordered[-1])

    @property
    def spread(self) -> tuple[float, ...]:
        """Cells under ``spread``."""
        return self[1:]

    def arrivals(self, sent: int) -> tuple[float, ...]:
        """Cells under ``ARRIVALS``, where these are the latencies of messages that were sent."""
        return (self.number, sent - self.number, *self.spread)


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


class ResultTable(NamedTuple):
    """Rows that are shown under a title and written to ``NAME.csv``."""

    name: str
    title: str
    header: Sequence[str]
    rows: Rows


class Results:
    """Results of one measurement, in the order in which they are shown."""

    def __init__(self) -> None:
        """Note the load of the machine, which is shown for the time from now on."""
        self.tables: list[ResultTable] = []
        self.targets: list[Row] = []  # what was measured, its value, its target, whether it is met
        self.met = True  # all of them
        self.pictures: list[tuple[str, Callable[[Path], None]]] = []  # names, how to draw a file
        psutil.cpu_percent()
        self._load_average = os.getloadavg()[0]
        self._machine: Rows = ()

    def end(self) -> None:
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

    def table(self, name: str, title: str, header: Sequence[str], rows: Rows) -> None:
        self.tables.append(ResultTable(name, title, header, list(rows)))

    def verdict(self, what: str, measured: float, limit: float, at_least: bool = False) -> None:
        is_met = measured >= limit if at_least else measured <= limit
        target = f"{'>=' if at_least else '<='} {limit:g}"
        self.targets.append((what, measured, target, "met" if is_met else "NOT met"))
        self.met = self.met and is_met

    def show(self) -> str:
        """Lay everything out for the terminal."""
        tables = self._all_tables()
        if not self.targets:
            tables[-1] = ResultTable("", "no target applies to what was measured", (), ())
        return "\n\n".join("\n".join([each.title, *_lines(each)]) for each in tables)

    def write(self, directory: Path) -> list[Path]:
        """Write all files into a directory; returns their paths."""
        written = []
        for each in self._all_tables():
            written.append(directory / f"{each.name}.csv")
            with written[-1].open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(each.header)
                writer.writerows(_texts(row) for row in each.rows)
        for name, draw in self.pictures:
            for suffix in (".png", ".svg"):
                written.append(directory / (name + suffix))
                draw(written[-1])
        return written

    def _all_tables(self) -> list[ResultTable]:
        return [
            *self.tables,
            ResultTable("machine", "the machine", ("what", "value"), self._machine),
            ResultTable("targets", "targets", ("what", "measured", "target", "met"), self.targets),
        ]


def _lines(table: ResultTable) -> list[str]:
    """Lay a table out in columns: text to the left, numbers to the right."""
    by_column = list(zip(*table.rows))
    right = [n for n, cells in enumerate(by_column) if not any(isinstance(c, str) for c in cells)]
    return columns([table.header, *map(_texts, table.rows)], right)


def _texts(row: Row) -> list[str]:
    def text(cell: Cell) -> str:
        return f"{cell:.{3 if abs(cell) < 100 else 1}f}" if isinstance(cell, float) else str(cell)

    return [text(cell) for cell in row]


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())
