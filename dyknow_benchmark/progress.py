# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shows the progress of a measurement on standard error."""

from __future__ import annotations

import sys
from typing import Iterable, Iterator, TypeVar

from tqdm import tqdm

T = TypeVar("T")


def say(text: str) -> None:
    """Print a line to the terminal, above a bar that is there."""
    tqdm.write(text, file=sys.stderr)


def steps(things: Iterable[T], what: str, total: int, unit: str = "block") -> Iterator[T]:
    """Pass things on, with a bar if standard error is a terminal."""
    bar: Iterator[T] = tqdm(
        things, desc=what, total=total, unit=unit, disable=not sys.stderr.isatty(), leave=False
    )
    return bar
