# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Measurements as functions, and their options on the command line."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Callable

from dyknow_benchmark.parts import payload_of
from dyknow_benchmark.results import Results

Run = Callable[[argparse.Namespace, Results], None]

#: Where the files of the chain go without ``--out``: half an hour is not to be lost.
OUT = Path("figure4")
#: Help of the options that several measurements have.
_HELP = {"rate": "Hz; ", "messages": "of each; "}

#: Measurements by name, in the order in which they are declared.
MEASUREMENTS: dict[str, Run] = {}

PARSER = argparse.ArgumentParser(
    prog="rosrun dyknow benchmark",
    description="Measures DyKnow beside its peers. Each measurement but plan starts a ROS master "
    "and processes of its own, on the loopback interface, and ends them. Without a name it is "
    "chain.",
)
_COMMANDS = PARSER.add_subparsers(dest="command", metavar="MEASUREMENT", required=True)


def measurement(**options: Any) -> Callable[[Run], Run]:
    """Declare a measurement, with the defaults of its options or argparse's words for them."""

    def declare(run: Run) -> Run:
        name, (first, _, description) = run.__name__, (run.__doc__ or "").partition("\n")
        text = first[:1].lower() + first[1:].rstrip(".")
        description = f"{text}. {description}"
        # An abbreviated --quick would set nothing.
        parser = _COMMANDS.add_parser(name, help=text, description=description, allow_abbrev=False)
        for option, given in options.items():
            parser.add_argument(f"--{option}", **_words(option, given))
        out = OUT if name == "chain" else None
        where = f"write the files here (default: {out})" if out else "write CSV files here"
        parser.add_argument("--out", type=Path, metavar="DIR", default=out, help=where)
        text = "exit with 1 if a target is not met"
        parser.add_argument("--check", action="store_true", help=text)
        MEASUREMENTS[name] = run
        return run

    return declare


def _words(name: str, given: Any) -> dict[str, Any]:
    if isinstance(given, dict):
        return given
    several = isinstance(given, list)
    shown = " ".join(map(str, given)) if several else "%(default)s"
    first = given[0] if several else given
    read = {int: positive, float: rate, str: payload}[type(first)]
    words = {"default": given, "type": read, "help": f"{_HELP.get(name, '')}default: {shown}"}
    return {**words, "nargs": "+", "metavar": "N"} if several else words


def positive(text: str) -> int:
    """Read an integer from 1 on."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected a number from 1 on, not {text}")
    return value


def rate(text: str) -> float:
    """Read a number above 0."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"expected a number above 0, not {text}")
    return value


def payload(text: str) -> str:
    """Read the content of messages: ``time``, or the size of images, such as 640x480."""
    try:
        payload_of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text
