# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`dyknow`: the command line of the DyKnow manager."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
from typing import TYPE_CHECKING, Optional, Sequence

from dyknow.cli.parser import all_commands, parse
from dyknow.cli.shell import BROKEN_PIPE, DONE, FAILED, INTERRUPTED, UNREACHABLE, Shell
from dyknow.errors import DyKnowError, ManagerUnreachable

if TYPE_CHECKING:
    from dyknow.ros.shell_client import ShellClient


class _Warnings(logging.Handler):
    """Prints the warnings of the client as those of the command."""

    def __init__(self, shell: Shell) -> None:
        super().__init__(logging.WARNING)
        self._shell = shell

    def emit(self, record: logging.LogRecord) -> None:
        """Print one."""
        self._shell.warn(record.getMessage())


def main(words: Optional[Sequence[str]] = None) -> int:
    """Run a command and return its exit code.

    Args:
        words: the command line without the program's name; by default the process's.
    """
    try:
        # A shell that starts jobs in the background lets them ignore SIGINT; scripts/dyknow lets
        # it end the process while modules are loaded.
        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return _run(sys.argv[1:] if words is None else words)
    except KeyboardInterrupt:
        if sys.stderr.isatty():
            sys.stderr.write("\n")  # behind the terminal's ^C
        return INTERRUPTED


def execute(arguments: argparse.Namespace, shell: Shell) -> int:
    """Run the parsed command and return its exit code; an error is printed as one line."""
    try:
        code = all_commands()[arguments.command].run(arguments, shell)
    except ManagerUnreachable as error:
        shell.error(error)
        return UNREACHABLE
    except DyKnowError as error:
        shell.error(error)
        return FAILED
    return DONE if code is None else code


def _run(words: Sequence[str]) -> int:
    try:
        arguments = parse(words)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else FAILED

    def connect() -> ShellClient:
        from dyknow.ros.shell_client import ShellClient

        return ShellClient(arguments.manager_node, arguments.timeout)

    shell = Shell(connect, arguments.json)
    warnings, logger = _Warnings(shell), logging.getLogger("rosout.dyknow")
    logger.addHandler(warnings)
    try:
        code = execute(arguments, shell)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader of our output is gone; the interpreter's own flush at exit must not complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    finally:
        logger.removeHandler(warnings)
    return code


if __name__ == "__main__":
    sys.exit(main())
