# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A command of `dyknow`: its help, its arguments, and its function."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Callable, Optional

from dyknow.cli.shell import Shell


@dataclass(frozen=True)
class Command:
    """One command.

    Attributes:
        name: what the user types.
        summary: half a line for the list of commands.
        description: a paragraph for its own help.
        examples: command lines, one a line.
        add_arguments: declares its arguments, besides those that all commands have.
        run: runs the command; returns the exit code, None for success. Raises DyKnowError.
        problem: returns what is wrong with a combination of arguments, or an empty text.
    """

    name: str
    summary: str
    description: str
    examples: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace, Shell], Optional[int]]
    problem: Callable[[argparse.Namespace], str] = lambda arguments: ""
