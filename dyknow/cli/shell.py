# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A command of `dyknow`, its arguments, and the environment in which it runs."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
from dataclasses import dataclass, replace
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Iterable,
    Iterator,
    Optional,
    Sequence,
    TextIO,
    Tuple,
)

from dyknow import names
from dyknow.cli.arguments import Argument
from dyknow.errors import DyKnowError, ManagerUnreachable

if TYPE_CHECKING:
    from dyknow.model.graph import Model
    from dyknow.ros.shell.shell_client import ShellClient

DONE = 0
FAILED = 1
UNREACHABLE = 3
INTERRUPTED = 130
BROKEN_PIPE = 141

#: What was done with one of several subjects: values for JSON, and lines.
Acted = Tuple[Sequence[Any], Sequence[str]]


@contextlib.contextmanager
def written(out: TextIO) -> Iterator[None]:
    """Send what the block writes to standard output at once: its reader may be a pipe.

    Raises:
        BrokenPipeError: the reader has gone.
        DyKnowError: it cannot be written for another reason, such as a full disk.
    """
    try:
        try:
            yield
        finally:
            out.flush()
    except OSError as error:
        # What is left goes nowhere, or the interpreter would complain about it when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), out.fileno())
        if isinstance(error, BrokenPipeError):
            raise
        raise DyKnowError(f"standard output cannot be written: {error.strerror}") from error


class Shell:
    """The client, which is made when it is first needed, and the output of one command.

    Results go to `out`, as lines or as one JSON value; everything else to `err`, in lines that
    begin with the program's name.
    """

    def __init__(
        self,
        connect: Callable[[], ShellClient],
        as_json: bool = False,
        out: TextIO | None = None,
        err: TextIO | None = None,
    ) -> None:
        self.as_json = as_json
        self.out = sys.stdout if out is None else out
        self.err = sys.stderr if err is None else err
        self._connect = connect
        self._client: ShellClient | None = None

    @property
    def client(self) -> ShellClient:
        if self._client is None:
            self._client = self._connect()
        return self._client

    def resolve(self, name: str) -> str:
        """Make a name global: relative ones begin in the manager's namespace."""
        return name if name == "/" else names.resolve(name, self.client.namespace, "/")

    def graph(self, namespace: str | None) -> Model:
        """Return the model without its transformations; if given, of a namespace alone."""
        model = self.client.get_graph()
        if not namespace:
            return model
        space = self.resolve(namespace)
        inside = space.rstrip("/") + "/"
        nodelets = tuple(each for each in model.nodelets if each.name.startswith(inside))
        if not nodelets and space != "/":
            hint = f"; it is a nodelet: see 'dyknow info {space}'" * bool(model.nodelet(space))
            self.warn(f"no nodelet is in the namespace '{space}'{hint}")
        return replace(model, nodelets=nodelets)

    def show(self, value: Any, lines: Iterable[str], indent: int | None = 2) -> None:
        """Print a result: the value as JSON, in one line without an indent, or else the lines."""
        shown = [json.dumps(value, indent=indent)] if self.as_json else lines
        self.write("".join(line + "\n" for line in shown))

    def show_file(self, value: Any, text: str) -> None:
        """Print what may become a file, in UTF-8 whatever the locale's encoding is."""
        if self.as_json:
            self.show(value, ())
            return
        with written(self.out):
            if hasattr(self.out, "buffer"):
                self.out.flush()
                self.out.buffer.write(text.encode("utf-8"))
            else:
                self.out.write(text)

    def write(self, text: str) -> None:
        with written(self.out):
            self.out.write(text)

    def for_each(
        self,
        kind: str,
        done: str,
        subjects: Iterable[str],
        act: Callable[[str], Acted | None],
        indent: int | None = 2,
    ) -> int | None:
        """Act on every subject, also after one was refused; return the exit code.

        In JSON, ``done`` is the key of the subjects, or of what ``act`` returns for them, and
        ``kind`` that of each in a failure.
        """
        acted: list[Any] = []
        lines: list[str] = []
        failed: list[dict[str, str]] = []
        for subject in subjects:
            try:
                values, said = act(subject) or ([subject], [f"{done} {subject}"])
            except ManagerUnreachable:
                if lines:
                    self.show({done: acted, "failed": failed}, lines, indent)
                raise
            except DyKnowError as error:
                for line in str(error).splitlines():
                    self.error(line)
                failed.append({kind: subject, "message": str(error)})
            else:
                acted += values
                lines += said
        self.show({done: acted, "failed": failed}, lines, indent)
        return FAILED if failed else None

    def tell_wait(self, service: str) -> None:
        """Say on a terminal that the answer of a service takes long."""
        if self.err.isatty():
            self.error(f"still waiting for {service}")

    def error(self, message: object) -> None:
        self.err.write(f"dyknow: {message}\n")

    def warn(self, messages: str) -> None:
        for line in messages.splitlines():
            self.error(f"warning: {line}")


Run = Callable[[argparse.Namespace, Shell], Optional[int]]


@dataclass(frozen=True)
class Command:
    """One command, of the name of the function that runs it.

    That returns the exit code, None for success, and raises DyKnowError; it may first call
    ``arguments.refuse`` with what is wrong if they do not go together.
    """

    run: Run
    description: str  # a paragraph for its help
    examples: str  # command lines, one a line
    arguments: Sequence[Argument]  # besides those of all commands
    usage: str | None = None  # the first line of its help, by default argparse's

    @property
    def name(self) -> str:
        return self.run.__name__.strip("_")


def command(
    description: str, examples: str, *arguments: Argument, usage: str | None = None
) -> Callable[[Run], Command]:
    """Make a command of the function that runs it; the arguments are those of `Command`."""
    return lambda run: Command(run, description, examples, arguments, usage)
