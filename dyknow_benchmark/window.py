# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark window``: how long the window keeps hands waiting, with many nodelets.

The window runs without a screen, in this process. It is opened, its nodelets come back one after
the other while it looks on, and it is zoomed and moved. The nodelets of the simulated manager come
back at a fixed pace; those of the real one after kill -9 of the DyKnow manager and of its nodelet
manager. A gap is the time between two turns of the window's event loop, or two frames.
"""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING, List, Sequence

from dyknow_benchmark import machine, options, progress
from dyknow_benchmark.results import Results
from dyknow_benchmark.targets import Verdict

if TYPE_CHECKING:
    from dyknow_benchmark.window_hands import Row

HEADER = ("manager", "nodelets", "what", "frames", "frames_per_s", "median_ms", "longest_ms")
#: Milliseconds.
_LONGEST_GAP = 200.0
_LEAST_FRAMES = 30.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--nodelets", type=options.positive, nargs="+", default=[50, 200, 500])
    parser.add_argument(
        "--restored",
        type=int,
        default=500,
        metavar="N",
        help="nodelets of the real manager; 0 to leave it out (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    os.environ["QT_QPA_PLATFORM"] = "offscreen"
    from dyknow_benchmark import window_hands  # only here: not every robot has Qt

    load = machine.Load()
    rows: List[Row] = []
    with window_hands.application():
        for count in arguments.nodelets:
            progress.say(f"simulated manager, {count} nodelets")
            rows += window_hands.simulated(count)
        if arguments.restored:
            progress.say(f"real manager, {arguments.restored} nodelets")
            rows += window_hands.real(arguments.restored)
    results = Results(load.rows(), _verdicts(rows))
    results.table("window", "gaps between two turns of the window", HEADER, rows)
    return results


def _verdicts(rows: Sequence[Row]) -> List[Verdict]:
    most = max(row.nodelets for row in rows)
    verdicts = []
    for row in rows:
        if row.nodelets == most:
            what = f"{row.nodelets} nodelets, {row.manager} manager, {row.what}"
            verdicts.append(Verdict(f"{what}: longest gap in ms", row.longest_ms, _LONGEST_GAP))
            if row.is_moved:
                fps = Verdict(f"{what}: frames a second", row.fps, _LEAST_FRAMES, at_least=True)
                verdicts.append(fps)
    return verdicts
