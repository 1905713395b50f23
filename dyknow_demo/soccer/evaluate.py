# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Measures the case study: ``python3 -m dyknow_demo.soccer.evaluate``.

Prints how far the ball's place on the simulated field is off, for both cameras, and, where there
are annotated frames of real cameras, how many of their balls are found.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence

import numpy as np

from dyknow_demo.shared_frames import SHARED_FRAMES
from dyknow_demo.soccer.accuracy import EYES, measure
from dyknow_demo.soccer.annotations import read_frames
from dyknow_demo.soccer.contact_sheet import write_sheet
from dyknow_demo.soccer.recall import OVERLAP, FrameResult, evaluate_frame

SEEDS = range(5)
_TIMES = [0.48 * number for number in range(200)]  # a round of the ball, 96 s


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Measure and print.

    Returns:
        0, or 1 if there are no frames where the arguments say.
    """
    options = _parse(argv)
    if not options.no_simulation:
        _print_accuracy()
    folder = options.frames or (SHARED_FRAMES if SHARED_FRAMES.is_dir() else None)
    if folder is None:
        print("real frames: skipped, there are none (--frames DIR)")
        return 0
    frames = read_frames(folder)
    if not frames:
        print(f"no annotated frames in '{folder}'", file=sys.stderr)
        return 1
    results = [evaluate_frame(frame) for frame in frames]
    _print_recall(results, folder)
    if options.sheet is not None:
        write_sheet(results, options.sheet)
        print(f"contact sheet: {options.sheet}")
    return 0


def _parse(argv: Optional[Sequence[str]]) -> Any:
    parser = argparse.ArgumentParser(prog="dyknow_demo.soccer.evaluate", description=__doc__)
    parser.add_argument(
        "--frames",
        type=Path,
        metavar="DIR",
        help="folder of images with YOLO annotations; by default shared/data/robocup_msl beside "
        "the checkout, if it is there",
    )
    parser.add_argument("--sheet", type=Path, metavar="PNG", help="draw finds and balls into this")
    parser.add_argument("--no-simulation", action="store_true", help="real frames only")
    return parser.parse_args(argv)


def _print_accuracy() -> None:
    print(f"Simulated field, {len(SEEDS)} seeds x {len(_TIMES)} frames: error on the field in m")
    print(f"{'camera':16}{'in view':>8}{'found':>7}{'false':>7}{'median':>8}{'p95':>7}{'max':>7}")
    for name in EYES:
        runs = [measure(name, seed, _TIMES) for seed in SEEDS]
        errors = [error for run in runs for error in run.errors]
        in_view, false = sum(run.frames for run in runs), sum(run.false_finds for run in runs)
        median, high, most = np.percentile(errors, (50, 95, 100))
        counts = f"{in_view:8}{len(errors):7}{false:7}"
        print(f"{name:16}{counts}{median:8.3f}{high:7.3f}{most:7.3f}")
    print()


def _print_recall(results: List[FrameResult], folder: Path) -> None:
    print(f"Real frames: {len(results)} from {folder}")
    print(
        f"a hit: intersection over union of the boxes >= {OVERLAP:g}, or each centre in the other"
    )
    print(f"{'frames':34}{'balls':>6}{'found':>7}{'recall':>8}{'best':>6}{'false':>7}")
    days: Dict[str, List[FrameResult]] = {}
    for each in results:
        days.setdefault(each.frame.day, []).append(each)
    for label, some in (*days.items(), ("all", results)):
        balls, found = sum(len(each.balls) for each in some), sum(each.found for each in some)
        best = sum(each.best_is_ball for each in some)
        false = sum(each.false_finds for each in some)
        recall = found / balls if balls else float("nan")
        print(f"{label:34}{balls:6}{found:7}{recall:8.2f}{best:6}{false:7}")
    missed = [each.frame.image.name for each in results if each.found < len(each.balls)]
    print(f"missed in: {', '.join(missed) or 'none'}")


if __name__ == "__main__":
    sys.exit(main())
