# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``rosrun dyknow benchmark``: the command line."""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import traceback
from typing import Sequence

import rospy

from dyknow.errors import DyKnowError
from dyknow.ros.process.signals import raise_interrupt, sigint
from dyknow_benchmark import arrival, formulas, isolation, switching, system
from dyknow_benchmark.options import MEASUREMENTS, PARSER
from dyknow_benchmark.results import Results

TARGET_NOT_MET, FAILED, INTERRUPTED = 1, 2, 130

#: The modules that declare measurements, in the order of the help.
MODULES = (arrival, isolation, switching, system, formulas)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the measurement of the command line and show its results.

    Returns:
        0; with ``--check`` 1 if a target is not met; 2 if it could not be measured or written.
    """
    arguments = parse(rospy.myargv()[1:] if argv is None else argv)
    results, out = Results(), arguments.out
    try:
        with sigint(raise_interrupt, signal.SIGTERM):  # its processes are ended too
            if out is not None:  # not after half an hour of measuring
                out.mkdir(parents=True, exist_ok=True)
                tempfile.TemporaryFile(dir=out).close()
            MEASUREMENTS[arguments.command](arguments, results)
            results.end()
            print(results.show())
            for path in results.write(out) if out is not None else ():
                print(f"wrote {path}")
    except (DyKnowError, OSError) as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return FAILED
    except Exception:  # the boundary: 1 would say that a target is not met
        traceback.print_exc()
        return FAILED
    except KeyboardInterrupt:
        print("benchmark: interrupted, nothing is written", file=sys.stderr)
        return INTERRUPTED
    return TARGET_NOT_MET if arguments.check and not results.met else 0


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Read a command line; where it begins with an option or is empty, ``chain`` is meant."""
    if not words or (words[0].startswith("-") and words[0] not in ("-h", "--help")):
        words = ["chain", *words]
    if "--quick" in words:
        words = [words[0], *arrival.QUICK, *words[1:]]
    return PARSER.parse_args(words)
