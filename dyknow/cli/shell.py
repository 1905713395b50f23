# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A command of `dyknow`, and the environment in which it runs."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Callable, Dict, Iterable, List, Optional, TextIO

from dyknow import names
from dyknow.errors import DyKnowError, ManagerUnreachable

if TYPE_CHECKING:
    from dyknow.ros.shell.shell_client import ShellClient


DONE = 0
FAILED = 1
USAGE = 2
UNREACHABLE = 3
INTERRUPTED = 130
BROKEN_PIPE = 141


class Shell:
    """The client and the output of one command.

    Results go to `out`, as lines or as one JSON value; everything else to `err`, in lines that
    begin with the program's name.
    """

    def __init__(
        self,
        connect: Callable[[], ShellClient],
        as_json: bool = False,
        out: Optional[TextIO] = None,
        err: Optional[TextIO] = None,
    ) -> None:
        """Set up the environment; the client is made when it is first needed.

        Args:
            connect: makes the client.
            as_json: print results as JSON.
            out: where results go; by default standard output.
            err: where errors and warnings go; by default standard error.
        """
        self.as_json = as_json
        self.out = sys.stdout if out is None else out
        self.err = sys.stderr if err is None else err
        self._connect = connect
        self._client: Optional[ShellClient] = None

    @property
    def client(self) -> ShellClient:
        """The client of the manager."""
        if self._client is None:
            self._client = self._connect()
        return self._client

    def resolve(self, name: str) -> str:
        """Make a name global: relative ones begin in the manager's namespace."""
        return name if name == "/" else names.resolve(name, self.client.namespace, "/")

    def show(self, value: Any, lines: Iterable[str]) -> None:
        """Print a result: the value as JSON, or else the lines."""
        if self.as_json:
            self.out.write(json.dumps(value, indent=2) + "\n")
        else:
            for line in lines:
                self.out.write(line + "\n")

    def for_each(
        self, kind: str, done: str, subjects: Iterable[str], act: Callable[[str], object]
    ) -> Optional[int]:
        """Act on every subject, also after one was refused, and show the outcome.

        Args:
            kind: the kind of the subjects, which is the key in the JSON of a failure.
            done: the outcome, in words and as key.
            subjects: names, labels or ids.
            act: acts on one; raises DyKnowError.

        Returns:
            The exit code.
        """
        acted: List[str] = []
        failed: List[Dict[str, str]] = []
        for subject in subjects:
            try:
                act(subject)
            except ManagerUnreachable:
                raise
            except DyKnowError as error:
                self.error(error)
                failed.append({kind: subject, "message": str(error)})
            else:
                acted.append(subject)
        self.show({done: acted, "failed": failed}, [f"{done} {each}" for each in acted])
        return FAILED if failed else None

    def error(self, message: object) -> None:
        """Print an error."""
        self.out.flush()
        self.err.write(f"dyknow: {message}\n")

    def warn(self, message: object) -> None:
        """Print a warning."""
        self.error(f"warning: {message}")


@dataclass(frozen=True)
class Command:
    """One command.

    Attributes:
        name: its word on the command line.
        summary: half a line for the list of commands.
        description: a paragraph for its own help.
        examples: command lines, one a line.
        add_arguments: declares its arguments, besides those that all commands have.
        run: runs the command; returns the exit code, None for success. Raises DyKnowError.
        problem: explains why arguments do not go together; empty if they do.
    """

    name: str
    summary: str
    description: str
    examples: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace, Shell], Optional[int]]
    problem: Callable[[argparse.Namespace], str] = lambda arguments: ""
