# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command line of the demonstrations: the soccer field, or with ``--rewiring`` a chain."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path
from typing import Sequence

from dyknow.errors import DyKnowError

DONE, FAILED, INTERRUPTED = 0, 1, 130

_OTHER = "--rewiring"


def main(argv: Sequence[str] | None = None) -> int:
    """Run a demonstration.

    Args:
        argv: arguments without the program's name; by default those of the process.

    Returns:
        0 if it kept its promise, 1 if it did not or something failed, 130 after Ctrl-C.
    """
    given = sys.argv[1:] if argv is None else argv
    # roslaunch and rostest append their own arguments, such as __name:=demo.
    arguments = [each for each in given if ":=" not in each]
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


def _run(arguments: Sequence[str]) -> bool:
    """Run a demonstration; its modules are imported once its options are known to be right."""
    if _OTHER in arguments:
        options = _rewiring_parser().parse_args([each for each in arguments if each != _OTHER])
        from dyknow_demo import rewiring

        return rewiring.play(options)
    options = _soccer_parser().parse_args(arguments)
    from dyknow_demo import story

    return story.play(options)


def _soccer_parser() -> argparse.ArgumentParser:
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
        _OTHER,
        action="store_true",
        help="re-wire a chain of camera frames by hand instead, and count the frames; "
        "'--rewiring --help' has its options",
    )
    parser.add_argument(
        "--seconds",
        type=_positive,
        default=8.0,
        help="time for each of the three acts (%(default)g)",
    )
    parser.add_argument(
        "--max-silence",
        type=_positive,
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
    return parser


def _rewiring_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="rosrun dyknow demo --rewiring",
        description="Runs camera frames through a chain of nodelets, re-wires the chain while it "
        "runs, and counts the frames that were lost or doubled. Uses the ROS master that "
        "ROS_MASTER_URI names, or starts one for itself.",
        epilog="Exit code: 0 if no frame was lost, doubled or out of order, else 1; 130 after "
        "Ctrl-C.",
    )
    parser.add_argument(
        "--frames",
        type=_folder,
        metavar="DIR",
        help="folder of JPEG or PNG files; by default shared/data/robocup_msl beside the "
        "checkout, if it is there",
    )
    parser.add_argument("--rendered", action="store_true", help="render frames, use no files")
    parser.add_argument(
        "--seconds",
        type=_positive,
        default=6.0,
        help="time for each of the six wirings (%(default)g)",
    )
    parser.add_argument(
        "--rate", type=_positive, default=30.0, help="frames a second of each camera (%(default)g)"
    )
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"expected a number above 0, not {text}")
    return value


def _folder(text: str) -> Path:
    folder = Path(text)
    if not folder.is_dir():
        raise argparse.ArgumentTypeError(f"no folder '{text}'")
    return folder
