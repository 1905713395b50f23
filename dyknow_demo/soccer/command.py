# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Runs the demonstration for the command ``demo``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Sequence

from dyknow_demo.options import positive


def run(arguments: Sequence[str]) -> bool:
    """Run the demonstration; True if the position was never lost for longer than allowed.

    Raises:
        DyKnowError: something failed.
    """
    options = _parse(arguments)
    # Imported here, so that --help and usage errors answer at once.
    from dyknow_demo.soccer.stage import play

    return play(options.manager, options.seconds, options.max_silence, options.pictures)


def _parse(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="rosrun dyknow demo",
        description="Asks for the position of a ball on a soccer field. A robot tracks it with "
        "its own camera; when that goes, a camera at the ceiling takes its place behind the "
        "robot's own tracking; then the robot returns. Uses the ROS master that ROS_MASTER_URI "
        "names, or starts one for itself.",
        epilog="Exit code: 0 if the position was never lost for longer than the claim allows, "
        "else 1; 130 after Ctrl-C.",
    )
    parser.add_argument(
        "--rewiring",
        action="store_true",
        help="re-wire a chain of camera frames by hand instead, and count the frames; "
        "'--rewiring --help' has its options",
    )
    parser.add_argument(
        "--seconds",
        type=positive,
        default=8.0,
        help="time for each of the three acts (%(default)g)",
    )
    parser.add_argument(
        "--max-silence",
        type=positive,
        default=2.0,
        metavar="SECONDS",
        help="time without a position that is allowed (%(default)g)",
    )
    parser.add_argument(
        "--pictures",
        type=Path,
        default=Path("build/demo"),
        metavar="DIR",
        help="folder for the drawings of the graph (%(default)s)",
    )
    parser.add_argument(
        "--manager",
        default="",
        metavar="NAME",
        help="manager that runs and knows the soccer field; by default one is started",
    )
    return parser.parse_args(arguments)
