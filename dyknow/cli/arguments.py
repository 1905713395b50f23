# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The types of arguments: how each word is checked and read."""

from __future__ import annotations

import argparse
import math
import os
import sys
from typing import NoReturn

from dyknow import names
from dyknow.errors import InvalidName
from dyknow.model.graph import PortRef
from dyknow.model.transformation import Parameter

DEFAULT_MANAGER = "/dyknow_manager"


class Parser(argparse.ArgumentParser):
    """A parser that reports an error in one line and exits with code 2."""

    def error(self, message: str) -> NoReturn:
        sys.stderr.write(f"{self.prog}: {message} (see '{self.prog} --help')\n")
        raise SystemExit(2)


def _expected(text: str, what: str) -> argparse.ArgumentTypeError:
    return argparse.ArgumentTypeError(f"'{text}': expected {what}")


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
    return names.resolve(graph_name(text), os.environ.get("ROS_NAMESPACE") or "/", "/")


def default_manager() -> str:
    """Return the node that the environment names as the manager, else the usual one.

    Raises:
        argparse.ArgumentTypeError: the environment holds no name of a node.
    """
    try:
        return manager_node(os.environ.get("DYKNOW_MANAGER") or DEFAULT_MANAGER)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"$DYKNOW_MANAGER: {error}") from error


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


def port_topic(text: str) -> tuple[str, str]:
    port, _, topic = text.partition(":")
    if not (port and topic):
        raise _expected(text, "PORT:TOPIC, such as in:/camera/image")
    return port, _checked(topic, "topic name")


def given_parameter(text: str) -> Parameter:
    """Read `NAME=VALUE`; the type is left open."""
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise _expected(text, "NAME=VALUE, such as rate=5 or '?camera=cam1'")
    return Parameter(name, "", value)


def seconds(text: str) -> float:
    return _above_zero(text, "seconds, such as 0.5")


def hertz(text: str) -> float:
    return _above_zero(text, "Hz above 0, such as 10")


def _above_zero(text: str, expected: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise _expected(text, expected)
    return value


def seconds_or_none(text: str) -> float:
    """Read a duration of zero or more, in seconds."""
    return 0.0 if text in ("0", "0.0") else seconds(text)


def positive(text: str) -> int:
    if not text.isdecimal() or not int(text):
        raise _expected(text, "an integer of at least 1")
    return int(text)
