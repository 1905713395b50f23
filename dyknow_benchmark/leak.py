# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark leak``: leftovers of re-wiring and loading in a nodelet manager.

File descriptors, threads and registrations of the manager are counted before and after many
re-wirings and many cycles of load and unload; nothing may be left.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import rosgraph

from dyknow_benchmark import machine, options, progress
from dyknow_benchmark.managers import RunningManager
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import Session
from dyknow_benchmark.switching import ENDS, Switching
from dyknow_benchmark.targets import Verdict

HEADER = ("what", "before", "after")
#: The longest wait (s) for connections and threads of unloaded nodelets to end.
_SETTLE = 10.0
#: Cycles before the first count: they fill pools and caches.
_WARM_UP = 20


@dataclass(frozen=True)
class Census:
    """What a process holds at one moment."""

    file_descriptors: int
    threads: int
    registrations: int
    resident_kib: int

    @classmethod
    def take(cls, manager: RunningManager) -> Census:
        """Count what a nodelet manager holds now."""
        process = Path(f"/proc/{manager.pid}")
        state = rosgraph.Master("/benchmark").getSystemState()
        return cls(
            len(os.listdir(process / "fd")),
            len(os.listdir(process / "task")),
            sum(manager.name in nodes for kind in state for _, nodes in kind),
            int((process / "statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") // 1024,
        )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--cycles", type=options.positive, default=1000, help="of each kind (default: %(default)d)"
    )


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    with Session() as session:
        manager = RunningManager.python(session)
        switching = Switching(manager, rate=100.0)
        load = machine.Load()
        for _ in range(_WARM_UP):
            _cycle(manager, switching)
        before = _settled(manager)
        for _ in progress.steps(range(arguments.cycles), "leak", arguments.cycles, "cycle"):
            _cycle(manager, switching)
        after = _settled(manager)
    names = [field.name for field in fields(Census)]
    rows = list(zip(names, astuple(before), astuple(after)))
    results = Results(
        load.rows(),
        [
            Verdict(f"{name} left by {arguments.cycles} cycles", now - then, 0)
            for name, then, now in rows
            if name != "resident_kib"
        ],
    )
    results.table("leak", "what the nodelet manager holds", HEADER, rows)
    return results


def _cycle(manager: RunningManager, switching: Switching) -> None:
    for end in ENDS:
        switching.switch(end)
    name = "/benchmark/leak/hop"
    remappings = {f"/benchmark/leak/{port}": f"/benchmark/leak/{port}" for port in ("in", "out")}
    manager.load(name, "dyknow_benchmark/ChainHop", remappings)
    manager.unload(name)


def _settled(manager: RunningManager) -> Census:
    """Count until two counts in a row, a second apart, are the same, or time is up."""
    end = time.monotonic() + _SETTLE
    census = Census.take(manager)
    while time.monotonic() < end:
        before = census
        time.sleep(1.0)
        census = Census.take(manager)
        if astuple(census)[:3] == astuple(before)[:3]:
            break
    return census
