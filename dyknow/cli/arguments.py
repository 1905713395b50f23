# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The arguments of commands, and how each word is checked, read and completed."""

from __future__ import annotations

import argparse
import math
import os
import re
import sys
from typing import Any, Callable, Dict, NoReturn, Optional, Tuple

from dyknow import names
from dyknow.cli import completion
from dyknow.cli.completion import Completer
from dyknow.errors import InvalidName
from dyknow.model.graph import PortRef
from dyknow.model.transformation import Parameter

DEFAULT_MANAGER = "/dyknow_manager"
_HIGHEST = 2**31  # seconds that a duration of ROS cannot hold any more


class Parser(argparse.ArgumentParser):
    """A parser that reports an error in one line and exits with code 2."""

    def error(self, message: str) -> NoReturn:
        sys.stderr.write(f"{self.prog}: {message} (see '{self.prog} --help')\n")
        raise SystemExit(2)


def _expected(text: str, what: str) -> argparse.ArgumentTypeError:
    return argparse.ArgumentTypeError(f"'{text}': expected {what}")


def some_text(text: str) -> str:
    """Read a text that is not empty, as that of a variable of the shell that is not set is."""
    if not text:
        raise _expected(text, "a value")
    return text


def graph_name(text: str) -> str:
    """Read the name of a nodelet, a topic or a node."""
    if text.startswith("~"):
        raise argparse.ArgumentTypeError(
            f"'{text}' is a private name; expected a name such as camera or /robot/x"
        )
    return _checked(text)


def _checked(text: str, *kind: str) -> str:
    try:
        return names.check(text, *kind)
    except InvalidName as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def manager_node(text: str) -> str:
    """Read the name of the manager's node; relative ones begin in ROS_NAMESPACE."""
    return names.resolve(graph_name(text), _of_environment("ROS_NAMESPACE", "/", namespace), "/")


def default_manager() -> str:
    """Return the node that the environment names as the manager, else the usual one.

    Raises:
        argparse.ArgumentTypeError: the environment holds no name of a node.
    """
    return manager_node(_of_environment("DYKNOW_MANAGER", DEFAULT_MANAGER, graph_name))


def _of_environment(variable: str, default: str, read: Callable[[str], str]) -> str:
    try:
        return read(os.environ.get(variable) or default)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"${variable}: {error}") from error


def namespace(text: str) -> str:
    return text if text == "/" else graph_name(text)


def port_reference(text: str) -> PortRef:
    nodelet, _, port = text.rpartition(":")
    if not (nodelet and port):
        raise _expected(text, "NODELET:PORT, such as camera:image")
    return PortRef(graph_name(nodelet), port)


def port_or_topic(text: str) -> PortRef | str:
    """Read `NODELET:PORT`, or else the name of a topic, which has no colon."""
    return port_reference(text) if ":" in text else graph_name(text)


def port_and_end(text: str) -> tuple[str, PortRef | str]:
    port, _, end = text.partition(":")
    if not (port and end):
        raise _expected(text, "PORT:TOPIC or PORT:NODELET:PORT, such as in:/camera/image")
    return port, port_reference(end) if ":" in end else _checked(end, "topic name")


def given_parameter(text: str) -> Parameter:
    """Read `NAME=VALUE`, or `NAME:=VALUE` as ROS writes it; the type is left open."""
    name, equals, value = text.partition("=")
    name = name[:-1] if name.endswith(":") else name
    if not (name and equals):
        raise _expected(text, "NAME=VALUE, such as rate=5 or '?camera=cam1'")
    return Parameter(name, "", value)


def assignment(text: str) -> tuple[str, str]:
    """Read `PORT=VALUE`, or `VALUE` for the only port of a formula."""
    port, equals, value = text.partition("=")
    if not equals or "(" in port or "/" in port:
        return "", text
    if not port.isidentifier() or not value:
        raise _expected(text, "PORT=..., such as battery=/battery")
    return port, value


def _above_zero(text: str, expected: str = "seconds, such as 0.5") -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise _expected(text, expected)
    if value >= _HIGHEST:
        raise _expected(text, f"{expected}, and below {_HIGHEST}")
    return value


def seconds_or_none(text: str) -> float:
    """Read a duration of zero or more, in seconds."""
    return 0.0 if re.fullmatch(r"0+(\.0*)?|\.0+", text) else _above_zero(text)


def positive(text: str) -> int:
    if not text.isdecimal() or not int(text):
        raise _expected(text, "an integer of at least 1")
    return int(text)


#: Options of an option that takes several values, and may be repeated.
SEVERAL: Any = {"nargs": "+", "action": "extend", "default": []}

REPEATED: Any = {"action": "append", "default": []}  # options of an option that may be repeated

#: How the values of a placeholder are read and completed, unless an argument says otherwise.
KINDS: Dict[str, Tuple[Optional[Callable[[str], Any]], Optional[Completer]]] = {
    "A:PORT": (port_reference, completion.ports),
    "CODE": (some_text, None),
    "FILE": (some_text, completion.files),
    "FORMULA": (some_text, completion.formulas),
    "FROM": (port_or_topic, completion.stream_sources),
    "HOST": (some_text, completion.hosts),
    "HZ": (lambda text: _above_zero(text, "Hz above 0, such as 10"), None),
    "ID": (None, completion.claims),
    "LABEL": (some_text, completion.labels),
    "M": (graph_name, completion.nodelet_managers),
    "N": (positive, None),
    "NAME": (graph_name, completion.nodelets),
    "NAME=VALUE": (given_parameter, completion.parameters_of_label),
    "NS": (namespace, completion.namespaces),
    "OWL": (some_text, completion.files),
    "PARAM": (None, completion.parameters_of_nodelet),
    "PATTERN": (some_text, None),
    "PKG": (some_text, completion.packages),
    "PORT": (positive, None),
    "PORT:END": (port_and_end, completion.ports_of_label),
    "PORT=TAG": (assignment, None),
    "PORT=TOPIC": (assignment, completion.formula_topics),
    "S": (_above_zero, None),
    "SECONDS": (_above_zero, None),
    "T": (graph_name, completion.topics),
    "TAG": (None, completion.tags),
    "TO": (port_or_topic, completion.stream_targets),
    "TOPIC": (some_text, None),
    "TYPE": (some_text, None),
    "XML": (some_text, completion.files),
}


Argument = Callable[[Any], None]  # adds an argument, or a group of them, to a parser


def group(*arguments: Argument, title: str = "") -> Argument:
    """Give arguments a title in the help; without one, at most one of them may be given."""

    def add(parser: argparse.ArgumentParser) -> None:
        inside: Any = (
            parser.add_argument_group(title) if title else parser.add_mutually_exclusive_group()
        )
        for each in arguments:
            each(inside)

    return add


def argument(names: str, metavar: Optional[str], help_text: str, **options: Any) -> Argument:
    """Declare an argument: its name, or its options separated by blanks, and its placeholder.

    The ``options`` are argparse's, and ``completer``, which returns possible values; by default
    those of the placeholder.
    """
    read, completer = KINDS.get(metavar or "", (None, None))
    completer = options.pop("completer", completer)
    if read is not None:
        options.setdefault("type", read)
    if metavar is not None:
        options["metavar"] = metavar

    def add(parser: Any) -> None:
        action = parser.add_argument(*names.split(), help=help_text, **options)
        action.completer = completer
        if action.nargs == argparse.REMAINDER:  # there may be none
            action.required = False

    return add


def flag(names: str, help_text: str) -> Argument:
    """Declare an option without a value."""
    return argument(names, None, help_text, action="store_true")
