# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command line of `dyknow` as a whole."""

from __future__ import annotations

import argparse
import re
from typing import Dict, List, Sequence, Tuple

from dyknow import __version__
from dyknow.cli import completion
from dyknow.cli.arguments import (
    DEFAULT_MANAGER,
    Parser,
    default_manager,
    manager_node,
    seconds,
)
from dyknow.cli.command import Command
from dyknow.cli.commands import GROUPS
from dyknow.similar import did_you_mean

#: Arguments that roslaunch gives every node; a command ignores them.
_FROM_ROSLAUNCH = ("__name", "__log")
_ENVIRONMENT = {
    "__ns": "ROS_NAMESPACE",
    "__master": "ROS_MASTER_URI",
    "__ip": "ROS_IP",
    "__hostname": "ROS_HOSTNAME",
}

_COMMON = """\
Relative names of nodelets and topics begin in the namespace of the manager.
Exit codes: 0 done, 1 refused or failed, 2 wrong usage, 3 no manager or master.
"""


def all_commands() -> Dict[str, Command]:
    """Return every command by its name."""
    return {command.name: command for _, commands in GROUPS for command in commands}


def build_parser() -> Tuple[Parser, Dict[str, Parser]]:
    """Build the parser, and those of the commands by their names."""
    parser = Parser(
        prog="dyknow",
        usage="dyknow COMMAND [ARGUMENT ...]",
        description="Look at and change what runs under a DyKnow manager.",
        epilog=_epilog(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"dyknow {__version__}")
    _add_common(parser)
    chosen = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)
    chosen.required = True
    parsers = {}
    for command in all_commands().values():
        parsers[command.name] = _add(chosen, command)
    return parser, parsers


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Parse the words of a command line.

    Raises:
        SystemExit: help was asked for (0), or the usage is wrong (2).
    """
    parser, parsers = build_parser()
    completion.autocomplete(parser)
    words = _without_ros_words(parser, words)
    if not words:
        parser.error("a command is missing: dyknow COMMAND [ARGUMENT ...]")
    _check_command(parser, words)
    arguments = parser.parse_args(words)
    arguments.json = getattr(arguments, "json", False)
    arguments.timeout = getattr(arguments, "timeout", None)
    problem = all_commands()[arguments.command].problem(arguments)
    if problem:
        parsers[arguments.command].error(problem)
    try:
        arguments.manager_node = getattr(arguments, "manager_node", None) or default_manager()
    except argparse.ArgumentTypeError as error:
        parser.error(str(error))
    return arguments


def _without_ros_words(parser: Parser, words: Sequence[str]) -> List[str]:
    """Drop the arguments that roslaunch adds; refuse others that would have no effect.

    Private parameters, `_x:=y`, become those of a spawn.
    """
    own = [word for word in words if ":=" not in word]
    command = next((word for word in own if word in all_commands()), "")
    if command in ("run", "probe"):
        return list(words)  # they are the node's
    if command == "launch":  # they are the launch file's, and may stand among the options
        return [*own, *(f"--given={word}" for word in words if ":=" in word)]
    for word in words:
        name, is_given, value = word.partition(":=")
        if not is_given or name in _FROM_ROSLAUNCH:
            continue
        if command == "spawn" and re.match("_[^_]", name):
            own += ["--param", f"{name[1:]}={value}"]
        else:
            parser.error(f"'{word}' would have no effect: {_instead(command, word)}")
    return own


def _instead(command: str, word: str) -> str:
    """Say how to get what `a:=b` does elsewhere in ROS."""
    name, _, value = word.partition(":=")
    if name in _ENVIRONMENT:
        return f"set {_ENVIRONMENT[name]} in the environment"
    if command == "spawn":
        if re.match("[a-zA-Z/~]", value):
            return (
                f"connect a port of the new nodelet with --connect {name}:{value}, or set a "
                f"parameter with --param {name}={value}"
            )
        return f"set a parameter of the new nodelet with --param {name}={value}"
    return f"'dyknow {command}' takes neither remappings nor parameters"


def _check_command(parser: Parser, words: Sequence[str]) -> None:
    known = all_commands()
    first = words[0]
    if first.startswith("-") or first in known:
        return
    parser.error(f"there is no command '{first}'{did_you_mean(first, known)}")


def _add(chosen: argparse._SubParsersAction[Parser], command: Command) -> Parser:
    epilog = "Examples:\n" + "".join(f"  {line}\n" for line in command.examples.splitlines())
    parser = chosen.add_parser(
        command.name,
        prog=f"dyknow {command.name}",
        description=command.description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_arguments(parser)
    _add_common(parser)
    return parser


def _add_common(parser: argparse.ArgumentParser) -> None:
    # Without defaults: those would override an option that stands before the command.
    group = parser.add_argument_group("options of every command")
    group.add_argument(
        "--json",
        action="store_true",
        default=argparse.SUPPRESS,
        help="print the result as JSON",
    )
    completion.complete_with(
        group.add_argument(
            "--manager-node",
            metavar="NAME",
            type=manager_node,
            default=argparse.SUPPRESS,
            help=f"the manager's node (default: $DYKNOW_MANAGER, else {DEFAULT_MANAGER})",
        ),
        completion.managers,
    )
    group.add_argument(
        "--timeout",
        metavar="SECONDS",
        type=seconds,
        default=argparse.SUPPRESS,
        help="how long each answer may take (default: 5, changes 60)",
    )


def _epilog() -> str:
    lines: List[str] = []
    for title, commands in GROUPS:
        lines.append(f"{title}:")
        lines.extend(f"  {command.name:<12}{command.summary}" for command in commands)
        lines.append("")
    lines.append("'dyknow COMMAND --help' shows the arguments of a command, with examples.")
    return "\n".join(lines) + "\n" + _COMMON
