# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`dyknow`: the command line of the DyKnow manager."""

from __future__ import annotations

import argparse
import io
import logging
import os
import re
import sys
import textwrap
from typing import TYPE_CHECKING, Any, Container, Sequence

from dyknow import __version__
from dyknow.cli import completion
from dyknow.cli.arguments import (
    DEFAULT_MANAGER,
    Parser,
    argument,
    default_manager,
    group,
    manager_node,
)
from dyknow.cli.commands import COMMANDS, GROUPS, find
from dyknow.cli.shell import (
    BROKEN_PIPE,
    DONE,
    FAILED,
    INTERRUPTED,
    UNREACHABLE,
    Command,
    Shell,
    written,
)
from dyknow.errors import DyKnowError, ManagerUnreachable
from dyknow.ros.process.signals import ENDING, raise_interrupt, sigint
from dyknow.similar import did_you_mean

if TYPE_CHECKING:
    from dyknow.ros.shell.shell_client import ShellClient


#: Arguments that roslaunch adds for every node; a command ignores them.
_FROM_ROSLAUNCH = ("__name", "__log")
#: A remapping, or a parameter; `:=` may also stand in a formula.
_ROS_WORD = re.compile(r"[?~/_A-Za-z][\w/]*:=")
_ENVIRONMENT = {
    "__ns": "ROS_NAMESPACE",
    "__master": "ROS_MASTER_URI",
    "__ip": "ROS_IP",
    "__hostname": "ROS_HOSTNAME",
}

_CLOSING = """\
Relative names of nodelets and topics begin in the namespace of the manager.
Exit codes: 0 done, 1 refused or failed, 2 wrong usage, 3 no manager or master.
"""

# Without defaults: those would override an option that stands before the command.
_UNSET: Any = {"default": argparse.SUPPRESS}
_COMMON = group(
    argument("--json", None, "print the result as JSON", action="store_true", **_UNSET),
    argument(
        "--manager-node",
        "NAME",
        f"the manager's node (default: $DYKNOW_MANAGER, else {DEFAULT_MANAGER})",
        completer=completion.managers,
        type=manager_node,
        **_UNSET,
    ),
    argument(
        "--timeout", "SECONDS", "how long each answer may take (default: 5, changes 60)", **_UNSET
    ),
    title="options of every command",
)


def build_parser(used: Container[str] = COMMANDS) -> tuple[Parser, dict[str, Parser]]:
    """Build the parser, and those of the commands that are used by their names.

    The modules of these commands are imported; others have no arguments.
    """
    parser = Parser(
        prog="dyknow",
        usage="dyknow COMMAND [ARGUMENT ...]",
        description="Look at and change what runs under a DyKnow manager.",
        epilog=_epilog(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"dyknow {__version__}")
    _COMMON(parser)
    chosen = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)
    chosen.required = True
    parsers: dict[str, Parser] = {}
    for name in COMMANDS:
        if name in used:
            parsers[name] = _add(chosen, find(name))
        else:
            chosen.add_parser(name)
    return parser, parsers


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Parse the words of a command line.

    Raises:
        SystemExit: help was printed (0), or the usage is wrong (2).
    """
    # Where the shell asks for completions, its line has the words.
    parser, parsers = build_parser({*words, *os.environ.get("COMP_LINE", "").split()})
    completion.autocomplete(parser)
    value = _value_of_set(words, parsers["set"]) if "set" in parsers else None
    words = _without_ros_words(parser, words, value)
    if not words:
        parser.error("a command is missing: dyknow COMMAND [ARGUMENT ...]")
    if not words[0].startswith("-") and words[0] not in COMMANDS:
        parser.error(f"there is no command '{words[0]}'{did_you_mean(words[0], COMMANDS)}")
    common = argparse.Namespace(json=False, timeout=None, manager_node=None)
    arguments, others = parser.parse_known_args(words, common)
    if others:
        chosen = parsers[arguments.command]
        hint = did_you_mean(others[0], chosen._option_string_actions)
        chosen.error(f"unrecognized arguments: {' '.join(others)}{hint}")
    try:
        arguments.manager_node = arguments.manager_node or default_manager()
    except argparse.ArgumentTypeError as error:
        parser.error(str(error))
    return arguments


def _command_in(words: Sequence[str]) -> str:
    return next((word for word in words if word in COMMANDS), "")


def _value_of_set(words: Sequence[str], parser: Parser) -> int | None:
    """Return the place of a value for `set` that looks like an option, or like ROS's words.

    One that begins with `--` is an option, unless a word `--` stands before it.
    """
    if _command_in(words) != "set" or "--" in words:
        return None
    found: list[int] = []
    is_of_option = False
    for place in range(words.index("set") + 1, len(words)):
        word = words[place]
        option = parser._option_string_actions.get(word)
        if option is None and not is_of_option and not word.startswith(("--", "__")):
            found.append(place)
        is_of_option = option is not None and option.nargs is None
    value = words[found[2]] if len(found) > 2 else ""
    return found[2] if value.startswith("-") or ":=" in value else None


def _without_ros_words(
    parser: Parser, words: Sequence[str], value_of_set: int | None = None
) -> list[str]:
    """Drop the arguments that roslaunch adds; refuse those that would have no effect.

    Private parameters, `_x:=y`, become those of a spawn.
    """
    if value_of_set is not None:
        others = [*words[:value_of_set], *words[value_of_set + 1 :]]
        return [*_without_ros_words(parser, others), "--", words[value_of_set]]
    plain = [word for word in words if ":=" not in word]
    command = _command_in(plain)
    if command in ("run", "probe"):
        return list(words)  # they are the node's
    if command == "launch":  # they are the launch file's, and may stand among the options
        return [*plain, *(f"--given={word}" for word in words if ":=" in word)]
    own: list[str] = []
    parameters: list[str] = []
    option = ""
    for word in words:
        name, _, value = word.partition(":=")
        is_given = _ROS_WORD.match(word) is not None
        option = word if word.startswith("--") else option
        is_value = command == "spawn" and option.startswith("--param")
        if is_given and command == "spawn" and re.match("_[^_]", name):
            parameter = f"{name[1:]}={value}"
            if is_value:
                own.append(parameter)
            else:
                parameters += ["--param", parameter]
        elif is_value or not is_given:
            own.append(word)
        elif name not in _FROM_ROSLAUNCH:
            parser.error(f"'{word}' would have no effect: {_instead(command, word)}")
    return own + parameters


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


def _add(chosen: argparse._SubParsersAction[Parser], command: Command) -> Parser:
    parser = chosen.add_parser(
        command.name,
        prog=f"dyknow {command.name}",
        usage=command.usage,
        description=textwrap.fill(command.description, 79),
        epilog="Examples:\n" + textwrap.indent(command.examples, "  "),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    for add in (*command.arguments, _COMMON):
        add(parser)
    parser.set_defaults(run=command.run, refuse=parser.error)
    return parser


def _epilog() -> str:
    lines: list[str] = []
    for title, commands in GROUPS.items():
        lines.append(f"{title}:")
        lines.extend(f"  {name:<12}{summary}" for name, (_, summary) in commands.items())
        lines.append("")
    lines.append("'dyknow COMMAND --help' shows the arguments of a command, with examples.")
    return "\n".join(lines) + "\n" + _CLOSING


def main(words: Sequence[str] | None = None) -> int:
    """Run a command, by default that of the process, and return its exit code."""
    if words is None:
        _prepare_streams()
    try:
        with written(sys.stdout):  # help, too
            arguments = parse(sys.argv[1:] if words is None else words)
        with sigint(raise_interrupt, *ENDING):
            return _run(arguments)
    except SystemExit as end:  # argparse's
        return end.code if isinstance(end.code, int) else FAILED
    except BrokenPipeError:
        return BROKEN_PIPE
    except DyKnowError as error:
        sys.stderr.write(f"dyknow: {error}\n")
        return FAILED
    except KeyboardInterrupt:
        if sys.stderr.isatty():
            sys.stderr.write("\n")  # behind the terminal's ^C
        return INTERRUPTED


def _prepare_streams() -> None:
    """Let closed standard streams lead nowhere, and escape what the locale has no letters for."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # the lowest free descriptor is that of the stream
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def execute(arguments: argparse.Namespace, shell: Shell) -> int:
    """Run the parsed command and return its exit code; an error is printed as one line."""
    try:
        code = arguments.run(arguments, shell)
    except ManagerUnreachable as error:
        shell.error(error)
        return UNREACHABLE
    except DyKnowError as error:
        shell.error(error)
        return FAILED
    return DONE if code is None else code


def _run(arguments: argparse.Namespace) -> int:
    def connect() -> ShellClient:
        import dyknow.ros.lean  # noqa: F401
        from dyknow.ros.shell.shell_client import ShellClient

        return ShellClient(arguments.manager_node, arguments.timeout, shell.tell_wait)

    shell = Shell(connect, arguments.json)
    # The client's warnings are the command's.
    warnings, logger = logging.Handler(logging.WARNING), logging.getLogger("rosout.dyknow")
    warnings.emit = lambda record: shell.warn(record.getMessage())  # type: ignore[method-assign]
    logger.addHandler(warnings)
    try:
        return execute(arguments, shell)
    finally:
        logger.removeHandler(warnings)
