# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command line of the demonstration."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path
from typing import Sequence

from dyknow.errors import DyKnowError
from dyknow.ros.process.signals import raise_interrupt, sigint

DONE, FAILED, INTERRUPTED = 0, 1, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demonstration with arguments, by default those of the process.

    Returns 0 if it kept its promise, 1 if it did not or something failed, 130 after Ctrl-C.
    """
    given = sys.argv[1:] if argv is None else argv
    # roslaunch and rostest append their own arguments, such as __name:=demo.
    options = _parser().parse_args([each for each in given if ":=" not in each])
    from dyknow_demo.story import play  # once the options are known to be right

    try:
        # SIGTERM ends it as Ctrl-C does: the processes that it started end with it.
        with sigint(raise_interrupt, signal.SIGTERM):
            return DONE if play(options) else FAILED
    except KeyboardInterrupt:
        print("\ninterrupted", file=sys.stderr)
        return INTERRUPTED
    except DyKnowError as error:
        print(f"\ndemo: {error}", file=sys.stderr)
        return FAILED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="rosrun dyknow demo",
        description="Asks for the position of a ball on a soccer field. A robot tracks it with "
        "its own camera; when its battery runs low, a camera at the ceiling takes over behind the "
        "robot's own tracking; then the battery is charged. Uses the ROS master that "
        "ROS_MASTER_URI names, or starts one for itself.",
        epilog="Exit code: 0 if all went as told: the position was never lost for longer than the "
        "claim allows, it was right, and the same nodelets tracked the ball; else 1, and 2 for a "
        "wrong option; 130 after Ctrl-C.",
    )
    argument = parser.add_argument
    text = "time for each of the three acts (%(default)g)"
    argument("--seconds", type=_positive, default=8.0, help=text)
    text = "time without a position that is allowed (%(default)g)"
    argument("--max-silence", type=_positive, default=2.0, metavar="SECONDS", help=text)
    text, folder = "folder for the drawings of the graph (%(default)s)", Path("build/demo")
    argument("--pictures", type=Path, default=folder, metavar="DIR", help=text)
    text = "manager that runs and knows the soccer field; by default one is started"
    argument("--manager", default="", metavar="NAME", help=text)
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"expected a number above 0, not {text}")
    return value
