# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`rosrun dyknow nodelet`: nodelet_core's command line.

A manager or standalone process of this command hosts nodelets in Python; as a client (`load`,
`unload`) it serves managers in Python and in C++.
"""

from __future__ import annotations

import signal
import sys
from typing import Sequence

from dyknow.cli.node_help import NODELET_MANAGER, asks_for_help
from dyknow.cli.nodelet_arguments import (
    USAGE,
    Command,
    Help,
    LoadNodelet,
    RunManager,
    RunScript,
    RunStandalone,
    UsageError,
    parse,
)
from dyknow.errors import CannotRun
from dyknow.ros.exit_codes import DONE, FAILED, INTERRUPTED


def main(argv: Sequence[str] | None = None) -> int:
    """Run `nodelet` and return its exit code.

    Args:
        argv: The command line, program name first; by default the process's.
    """
    argv = list(sys.argv if argv is None else argv)
    try:
        command = parse(argv[1:])
    except UsageError as error:
        print(
            f"nodelet: {error}\nYour usage:\n{' '.join(argv)}\n\n{USAGE}", end="", file=sys.stderr
        )
        return FAILED
    try:
        return _run(command, argv)
    except KeyboardInterrupt:
        return INTERRUPTED


def manager_main(argv: Sequence[str] | None = None) -> int:
    """Run `nodelet_manager`, which is `nodelet manager`, and return its exit code."""
    argv = list(sys.argv if argv is None else argv)
    if asks_for_help(argv[1:]):
        print(NODELET_MANAGER, end="")
        return DONE
    return main([argv[0], "manager", *argv[1:]])


def _run(command: Command, argv: Sequence[str]) -> int:
    # Each command imports what it needs: --help and a wrong usage answer without waiting for
    # rospy.
    if isinstance(command, Help):
        print(USAGE, end="")
        return DONE
    if isinstance(command, RunManager):
        _end_at_once_when_interrupted()
        from dyknow.ros.nodelets.nodelet_manager import run_manager

        return run_manager(argv)
    if isinstance(command, RunStandalone):
        _end_at_once_when_interrupted()
        from dyknow.ros.nodelets.nodelet_manager import run_standalone

        print(f"type is {command.type}", flush=True)
        return run_standalone(command.type, command.my_argv, argv)
    if isinstance(command, RunScript):
        return run_script(command, argv)
    if isinstance(command, LoadNodelet):
        from dyknow.ros.nodelets.nodelet_client import run_load

        return run_load(
            command.default_name,
            command.type,
            command.manager,
            command.my_argv,
            command.bond,
            argv,
        )
    from dyknow.ros.nodelets.nodelet_client import run_unload

    return run_unload(command.name, command.manager, argv)


def run_script(command: RunScript, argv: Sequence[str]) -> int:
    """Become a script; returns the exit code only if that fails."""
    from dyknow.cli.rewirable import become_script
    from dyknow.ros.programs import find_script

    names = [word for word in argv if ":=" in word]
    try:
        become_script(
            [find_script(f"{command.package}/{command.script}"), *command.my_argv, *names]
        )
    except CannotRun as error:
        print(f"nodelet: {error}", file=sys.stderr)
        return FAILED


def _end_at_once_when_interrupted() -> None:
    """Let SIGINT end the process until the node handles it.

    A KeyboardInterrupt that is raised during an import may be lost.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)


if __name__ == "__main__":
    sys.exit(main())
