# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The machine of the measurement, and its load during it."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Sequence, Tuple

from dyknow_benchmark import tables

HEADER = ("what", "value")
_TICKS = os.sysconf("SC_CLK_TCK")


def cpu_seconds(pid: int) -> float:
    """CPU time that a process has used, user and system, all threads."""
    # The name in parentheses may hold spaces; what follows it does not.
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def model_name() -> str:
    """Name of the processor."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        name, _, value = line.partition(":")
        if name.strip() == "model name":
            return value.strip()
    return platform.processor() or platform.machine()


class Load:
    """The load of the machine from the construction on."""

    def __init__(self) -> None:
        self._before = _cpu_times()
        self._average = os.getloadavg()[0]

    def rows(self) -> Sequence[Tuple[str, tables.Cell]]:
        """Rows under ``HEADER``: the machine, and its load until now."""
        busy, total = (now - then for now, then in zip(_cpu_times(), self._before))
        return [
            ("processor", model_name()),
            ("cores", os.cpu_count() or 0),
            ("python", platform.python_version()),
            ("system", platform.platform()),
            ("load_average_before", self._average),
            ("load_average_after", os.getloadavg()[0]),
            ("busy_percent", 100.0 * busy / total if total else 0.0),
        ]


def _cpu_times() -> Tuple[int, int]:
    """Ticks that the cores were busy, and all ticks, since the machine started."""
    fields = [int(each) for each in Path("/proc/stat").read_text().splitlines()[0].split()[1:9]]
    idle = fields[3] + fields[4]
    return sum(fields) - idle, sum(fields)
