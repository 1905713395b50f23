# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``rosrun dyknow benchmark``: the command line."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Dict, Optional, Sequence

import rospy

from dyknow_benchmark import (
    busy,
    chain,
    cpp_ports,
    failover,
    fan,
    footprint,
    idle,
    images,
    leak,
    library,
    model,
    outside,
    plan,
    recover,
    rewire,
    scripts,
    throughput,
    window,
)
from dyknow_benchmark.results import Results, obstacle
from dyknow_benchmark.session import MeasurementFailed, interruptible

#: Measurements by name; each module has ``add_arguments``, ``run`` and a docstring.
_MEASUREMENTS: Dict[str, object] = {
    "chain": chain,
    "images": images,
    "throughput": throughput,
    "fan": fan,
    "busy": busy,
    "outside": outside,
    "rewire": rewire,
    "cpp": cpp_ports,
    "scripts": scripts,
    "leak": leak,
    "idle": idle,
    "footprint": footprint,
    "model": model,
    "library": library,
    "plan": plan,
    "recover": recover,
    "failover": failover,
    "window": window,
}

TARGET_NOT_MET, FAILED, INTERRUPTED = 1, 2, 130


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Measure what the command line names and show it.

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
            results = arguments.run(arguments)
    except MeasurementFailed as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        print("benchmark: interrupted, nothing is written", file=sys.stderr)
        return INTERRUPTED
    print(results.show())
    if arguments.out is not None and not _write(results, arguments.out):
        return FAILED
    return TARGET_NOT_MET if arguments.check and not results.met else 0


def _write(results: Results, directory: Path) -> bool:
    """Write the files and print their paths, or the reason why they cannot be written."""
    try:
        paths = results.write(directory)
    except OSError as error:
        print(f"benchmark: cannot write to {directory}: {error}", file=sys.stderr)
        return False
    for path in paths:
        print(f"wrote {path}")
    return True


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
    for name, module in _MEASUREMENTS.items():
        summary, _, description = (module.__doc__ or "").partition("\n")
        text = summary.partition(": ")[2].rstrip(".")
        command = commands.add_parser(name, help=text, description=f"{text}. {description}")
        module.add_arguments(command)  # type: ignore[attr-defined]
        out = command.get_default("out")
        where = f"write the files here (default: {out})" if out else "write CSV files here"
        command.add_argument("--out", type=Path, metavar="DIR", help=where)
        command.add_argument(
            "--check", action="store_true", help="exit with 1 if a target is not met"
        )
        command.set_defaults(run=module.run)  # type: ignore[attr-defined]
    return top
