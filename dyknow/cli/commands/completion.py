"""`complete`: what shells ask for when TAB is pressed."""

from __future__ import annotations

import argparse
import os
import signal
from typing import TYPE_CHECKING

from dyknow.cli.arguments import manager_node
from dyknow.cli.command import Command
from dyknow.cli.completion import complete
from dyknow.cli.shell import Shell
from dyknow.cli.shell_words import split

if TYPE_CHECKING:
    from dyknow.ros.shell_client import ShellClient

#: Seconds that each answer may take: who presses TAB does not wait.
_TIMEOUT = 0.2
#: Seconds after which it is given up altogether: a library of 100,000 labels takes longer.
_LIMIT = 1.0


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("line", metavar="LINE", help="the command line up to the cursor")


def _give_up(number: int, frame: object) -> None:
    raise TimeoutError


def _complete(arguments: argparse.Namespace, shell: Shell) -> None:
    def client(manager: str) -> ShellClient:
        from dyknow.ros.shell_client import ShellClient

        return ShellClient(manager_node(manager) if manager else arguments.manager_node, _TIMEOUT)

    line = split(arguments.line)
    signal.signal(signal.SIGALRM, _give_up)
    signal.setitimer(signal.ITIMER_REAL, _LIMIT)
    try:
        found = complete(arguments.parsers, line.words[1:], line.last, client)
    except Exception:  # a boundary: nobody wants to read of it between two key strokes
        if os.environ.get("DYKNOW_DEBUG_COMPLETION"):
            raise
        found = []
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    shell.show({"candidates": found}, [line.written(each) for each in found])


COMMANDS = (
    Command(
        "complete",
        "list what may stand at the cursor",
        "List what the last word of a command line may become, a candidate a line. Says nothing "
        "when nobody answers.",
        "dyknow complete 'dyknow info /cam'",
        _arguments,
        _complete,
    ),
)
