# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``rosrun dyknow benchmark``: the command line."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Sequence

import rospy

from dyknow_benchmark import arrival, switching, system
from dyknow_benchmark.options import MEASUREMENTS, measurement, positive
from dyknow_benchmark.results import Results, obstacle
from dyknow_benchmark.session import MeasurementFailed, interruptible, say

TARGET_NOT_MET, FAILED, INTERRUPTED = 1, 2, 130

#: The modules that declare measurements, in the order of the help.
MODULES = (arrival, switching, system)

#: Where the files of the chain go without ``--out``: half an hour is not to be lost.
OUT = Path("figure4")


@measurement(
    nodelets={
        "type": positive,
        "nargs": "+",
        "default": [50, 200, 500],
        "help": "default: 50 200 500",
    },
    restored={
        "type": int,
        "default": 500,
        "metavar": "N",
        "help": "nodelets of the real manager; 0 to leave it out (default: %(default)s)",
    },
)
def window(arguments: argparse.Namespace) -> Results:
    """How long the window keeps hands waiting, with many nodelets.

    The window runs without a screen, in this process. It is opened, its nodelets come back one
    after the other while it looks on, and it is zoomed and moved. The nodelets of the simulated
    manager come back at a fixed pace; those of the real one after kill -9 of the DyKnow manager
    and of its nodelet manager. A gap is the time between two turns of the window's event loop, or
    two frames.
    """
    os.environ["QT_QPA_PLATFORM"] = "offscreen"
    from dyknow_benchmark import window_hands  # only here: not every robot has Qt

    results, rows = Results(), []
    with window_hands.application():
        for count in arguments.nodelets:
            say(f"simulated manager, {count} nodelets")
            rows += window_hands.simulated(count)
        if arguments.restored:
            say(f"real manager, {arguments.restored} nodelets")
            rows += window_hands.real(arguments.restored)
    header = ("manager", "nodelets", "what", "frames", "frames_per_s", "median_ms", "longest_ms")
    results.table("window", "gaps between two turns of the window", header, rows)
    most = max(row.nodelets for row in rows)
    for manager in dict.fromkeys(row.manager for row in rows):
        own = [row for row in rows if row.manager == manager and row.nodelets == most]
        what = f"{most} nodelets, {manager} manager"
        longest = max(row.longest_ms for row in own)
        slowest = min(row.fps for row in own if row.is_moved)
        results.verdict(f"{what}: longest gap in ms", longest, 200.0)
        results.verdict(f"{what}: fewest frames a second", slowest, 30.0, at_least=True)
    return results


def main(argv: Sequence[str] | None = None) -> int:
    """Run the measurement of the command line and show its results.

    Returns:
        0; with ``--check`` 1 if a target is not met; 2 if it could not be measured or written.
    """
    words = rospy.myargv()[1:] if argv is None else argv
    arguments = parser().parse_args(with_measurement(words))
    reason = "" if arguments.out is None else obstacle(arguments.out)
    if reason:  # not after half an hour of measuring
        print(f"benchmark: cannot write to {arguments.out}: {reason}", file=sys.stderr)
        return FAILED
    try:
        with interruptible():
            results = MEASUREMENTS[arguments.command].run(arguments).end()
    except MeasurementFailed as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        print("benchmark: interrupted, nothing is written", file=sys.stderr)
        return INTERRUPTED
    print(results.show())
    if arguments.out is not None:
        try:
            for path in results.write(arguments.out):
                print(f"wrote {path}")
        except OSError as error:
            print(f"benchmark: cannot write to {arguments.out}: {error}", file=sys.stderr)
            return FAILED
    return TARGET_NOT_MET if arguments.check and not results.met else 0


def with_measurement(words: Sequence[str]) -> Sequence[str]:
    """Insert ``chain`` where a command line begins with an option or is empty."""
    if words and (not words[0].startswith("-") or words[0] in ("-h", "--help")):
        return words
    return ["chain", *words]


def parser() -> argparse.ArgumentParser:
    """Declare the commands."""
    top = argparse.ArgumentParser(
        prog="rosrun dyknow benchmark",
        description="Measures DyKnow beside its peers. Each measurement but plan starts a ROS "
        "master and processes of its own, on the loopback interface, and ends them. Without a "
        "name it is chain.",
    )
    commands = top.add_subparsers(dest="command", metavar="MEASUREMENT", required=True)
    for name, each in MEASUREMENTS.items():
        command = each.add_to(commands, name)
        out = OUT if name == "chain" else None
        where = f"write the files here (default: {out})" if out else "write CSV files here"
        command.add_argument("--out", type=Path, metavar="DIR", default=out, help=where)
        command.add_argument(
            "--check", action="store_true", help="exit with 1 if a target is not met"
        )
    return top
