"""``rosrun dyknow benchmark``: the command line."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Dict, Optional, Sequence

import rospy

from dyknow.benchmark import (
    chain,
    failover,
    idle,
    images,
    leak,
    library,
    model,
    plan,
    recover,
    rewire,
    throughput,
)
from dyknow.benchmark.session import MeasurementFailed, interruptible

#: Measurements by name; each module has ``add_arguments``, ``run`` and a docstring.
_MEASUREMENTS: Dict[str, object] = {
    "chain": chain,
    "images": images,
    "throughput": throughput,
    "rewire": rewire,
    "leak": leak,
    "idle": idle,
    "model": model,
    "library": library,
    "plan": plan,
    "recover": recover,
    "failover": failover,
}

TARGET_NOT_MET, FAILED, INTERRUPTED = 1, 2, 130


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Measure what the command line names and show it.

    Returns:
        0; with ``--check`` 1 if a target is not met; 2 if it could not be measured.
    """
    arguments = parser().parse_args(rospy.myargv(argv)[1:] if argv is None else argv)
    try:
        with interruptible():
            outcome = arguments.run(arguments)
    except MeasurementFailed as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        print("benchmark: interrupted, nothing is written", file=sys.stderr)
        return INTERRUPTED
    print(outcome.show())
    if arguments.out is not None:
        for path in outcome.write(arguments.out):
            print(f"wrote {path}")
    return TARGET_NOT_MET if arguments.check and not outcome.met else 0


def parser() -> argparse.ArgumentParser:
    """Declare the commands."""
    top = argparse.ArgumentParser(
        prog="rosrun dyknow benchmark",
        description="Measures DyKnow beside its peers. Each measurement but plan starts a ROS "
        "master and processes of its own, on the loopback interface, and ends them.",
    )
    commands = top.add_subparsers(dest="command", metavar="MEASUREMENT", required=True)
    for name, module in _MEASUREMENTS.items():
        summary, _, description = (module.__doc__ or "").partition("\n")
        text = summary.partition(": ")[2].rstrip(".")
        command = commands.add_parser(name, help=text, description=f"{text}. {description}")
        module.add_arguments(command)  # type: ignore[attr-defined]
        command.add_argument("--out", type=Path, metavar="DIR", help="write CSV files here")
        command.add_argument(
            "--check", action="store_true", help="exit with 1 if a target is not met"
        )
        command.set_defaults(run=module.run)  # type: ignore[attr-defined]
    return top
