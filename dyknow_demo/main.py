# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command line of the demonstrations: the soccer field, or with ``--rewiring`` a chain."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path
from typing import List, Optional, Sequence

from dyknow.errors import DyKnowError
from dyknow_demo.options import positive

DONE, FAILED, INTERRUPTED = 0, 1, 130

_OTHER = "--rewiring"


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Run a demonstration.

    Args:
        argv: arguments without the program's name; by default those of the process.

    Returns:
        0 if it kept what it promises, 1 if it did not or something failed, 130 after Ctrl-C.
    """
    given = sys.argv[1:] if argv is None else argv
    # roslaunch and rostest append arguments of theirs, such as __name:=demo.
    arguments: List[str] = [each for each in given if ":=" not in each]
    # SIGTERM ends it as Ctrl-C does: the processes that it started end with it.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return DONE if _run(arguments) else FAILED
    except KeyboardInterrupt:
        print("\ninterrupted", file=sys.stderr)
        return INTERRUPTED
    except DyKnowError as error:
        print(f"\ndemo: {error}", file=sys.stderr)
        return FAILED


def _run(arguments: List[str]) -> bool:
    """Run a demonstration; what it needs is imported after its options are known to be right."""
    if _OTHER in arguments:
        from dyknow_demo.rewiring import command as rewiring

        return rewiring.run([each for each in arguments if each != _OTHER])
    options = _parse(arguments)
    from dyknow_demo.soccer.story import Script, play

    return play(options.manager, Script(options.seconds, options.max_silence, options.pictures))


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
