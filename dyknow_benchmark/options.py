# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Measurements as functions, and their options on the command line."""

from __future__ import annotations

import argparse
from typing import Any, Callable, NamedTuple, Sequence

from dyknow_benchmark.parts import payload_of
from dyknow_benchmark.results import Results

Run = Callable[[argparse.Namespace], Results]

#: Help of the options that several measurements have.
_HELP = {"rate": "Hz", "messages": "of each"}


class Measurement(NamedTuple):
    """A measurement and its options: their names, with argparse's words for each."""

    run: Run
    options: dict[str, dict[str, Any]]

    def add_to(self, commands: Any, name: str) -> argparse.ArgumentParser:
        """Declare the command of the measurement."""
        help_, _, description = (self.run.__doc__ or "").partition("\n")
        text = help_.rstrip(".")
        text = text[:1].lower() + text[1:]
        parser: argparse.ArgumentParser = commands.add_parser(
            name, help=text, description=f"{text}. {description}"
        )
        for option, words in self.options.items():
            parser.add_argument(f"--{option}", **words)
        return parser


#: Measurements by name, in the order in which they are declared.
MEASUREMENTS: dict[str, Measurement] = {}


def measurement(**options: Any) -> Callable[[Run], Run]:
    """Declare a measurement, with the defaults of its options or argparse's words for them."""

    def declare(run: Run) -> Run:
        words = {name: _words(name, given) for name, given in options.items()}
        MEASUREMENTS[run.__name__] = Measurement(run, words)
        return run

    return declare


def _words(name: str, given: Any) -> dict[str, Any]:
    if isinstance(given, dict):
        return given
    shown = " ".join(map(str, given)) if isinstance(given, list) else "%(default)s"
    words: dict[str, Any] = {"default": given}
    words["help"] = f"{_HELP[name]} (default: {shown})" if name in _HELP else f"default: {shown}"
    if isinstance(given, list):
        words.update(nargs="+", metavar="N")
        given = given[0]
    return {**words, "type": rate if isinstance(given, float) else positive}


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


def size(text: str) -> str:
    """Read the size of an image, such as 640x480."""
    if text == "time":
        raise argparse.ArgumentTypeError("expected a size such as 640x480, not time")
    return payload(text)


def payload(text: str) -> str:
    """Read the content of messages: ``time``, or a size of images."""
    try:
        payload_of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text


def choice(some: Sequence[str], default: Sequence[str] | None, text: str) -> dict[str, Any]:
    """Declare an option that takes some of the names."""
    return {"nargs": "+", "choices": some, "metavar": "KIND", "default": default, "help": text}
