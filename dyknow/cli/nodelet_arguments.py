# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command line of `nodelet`, argument by argument that of nodelet_core.

Launch files written for `pkg="nodelet" type="nodelet"` work with another package name, so nothing
is added between the stock arguments, and everything behind them goes to the nodelet as its
`my_argv`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Sequence, Union

#: The nodelet that runs scripts.
SCRIPT_TYPE = "dyknow/Script"

USAGE = """\
usage: nodelet manager
       nodelet load PKG/CLASS MANAGER [--no-bond] [ARGUMENT ...]
       nodelet load_script PKG SCRIPT MANAGER [--no-bond] [ARGUMENT ...]
       nodelet standalone PKG/CLASS [ARGUMENT ...]
       nodelet standalone_script PKG SCRIPT [ARGUMENT ...]
       nodelet unload NAME MANAGER

  manager     run a nodelet manager, a process that hosts nodelets
  load        load a nodelet into a running manager, wait for the manager if it
              is not up yet, and unload the nodelet when this command is stopped
  load_script load an unchanged script of rospy as a nodelet
  standalone  run one nodelet in a process of its own
  standalone_script
              run an unchanged script of rospy in a process of its own, with
              ports that can be connected elsewhere while it runs
  unload      unload the nodelet NAME (/front/camera) from a manager

  PKG/CLASS   the nodelet's class as its package declares it, for instance
              dyknow/Relay
  SCRIPT      a script in Python, as for rosrun
  MANAGER     the manager's node name
  ARGUMENT    handed to the nodelet (my_argv), or to the script
  --no-bond   do not watch each other: otherwise the nodelet is unloaded when
              this command dies, and this command ends when the manager does

As everywhere in ROS, __name:=NAME names the manager or nodelet, __ns:=NS puts it
into a namespace, FROM:=TO remaps a name, and _PARAMETER:=VALUE sets a private
parameter. For example:

  rosrun dyknow nodelet manager __name:=cameras
  rosrun dyknow nodelet load dyknow/Throttle cameras __name:=slow in:=/image _rate:=5
  rosrun dyknow nodelet load_script topic_tools transform cameras /a /b std_msgs/Float64 2*m.data
"""


class UsageError(Exception):
    """The command line is wrong; the text says how."""


@dataclass(frozen=True)
class Help:
    """Print the usage."""


@dataclass(frozen=True)
class RunManager:
    """Run a nodelet manager."""

    my_argv: tuple[str, ...]


@dataclass(frozen=True)
class RunStandalone:
    """Run the nodelet of class `type` in a process of its own."""

    type: str
    my_argv: tuple[str, ...]


@dataclass(frozen=True)
class LoadNodelet:
    """Load a nodelet of class `type` into the manager, with a bond or without."""

    type: str
    manager: str
    bond: bool
    my_argv: tuple[str, ...]
    default_name: str


@dataclass(frozen=True)
class RunScript:
    """Run a script of a package in a process of its own."""

    package: str
    script: str
    my_argv: tuple[str, ...]


@dataclass(frozen=True)
class UnloadNodelet:
    """Unload the nodelet from the manager."""

    name: str
    manager: str


Command = Union[Help, RunManager, RunStandalone, RunScript, LoadNodelet, UnloadNodelet]


def parse(arguments: Sequence[str]) -> Command:
    """Parse a command line.

    Args:
        arguments: All but the program's name. ROS's own (`a:=b`) may stand anywhere and are left
            out.

    Raises:
        UsageError: The command is unknown, or something is missing.
    """
    words = tuple(word for word in arguments if ":=" not in word)
    if any(word in ("-h", "--help") for word in words[:2]):
        return Help()
    if not words:
        raise UsageError("a command is missing")
    command, rest = words[0], words[1:]
    if command == "manager":
        return RunManager(rest)
    if command == "standalone":
        _demand(command, rest, "PKG/CLASS")
        return RunStandalone(rest[0], rest[1:])
    if command == "load":
        _demand(command, rest, "PKG/CLASS", "MANAGER")
        bond, my_argv = _bond(rest[2:])
        return LoadNodelet(rest[0], rest[1], bond, my_argv, default_node_name(rest[0]))
    if command == "load_script":
        _demand(command, rest, "PKG", "SCRIPT", "MANAGER")
        bond, my_argv = _bond(rest[3:])
        words = (f"{rest[0]}/{rest[1]}", *my_argv)
        return LoadNodelet(SCRIPT_TYPE, rest[2], bond, words, script_node_name(rest[1]))
    if command == "standalone_script":
        _demand(command, rest, "PKG", "SCRIPT")
        return RunScript(rest[0], rest[1], rest[2:])
    if command == "unload":
        _demand(command, rest, "NAME", "MANAGER")
        return UnloadNodelet(rest[0], rest[1])
    raise UsageError(f"there is no command '{command}'")


def default_node_name(nodelet_type: str) -> str:
    """The name of a nodelet that was given none: `pkg/Class` becomes `pkg_Class`."""
    return nodelet_type.replace("/", "_")


def script_node_name(script: str) -> str:
    """The name of a script that was given none: `front_camera.py` becomes `front_camera`."""
    return re.sub(r"\W", "_", script.rpartition("/")[2].partition(".")[0])


def _bond(words: tuple[str, ...]) -> tuple[bool, tuple[str, ...]]:
    """Whether there is to be a bond, and the words behind the option."""
    return (False, words[1:]) if words[:1] == ("--no-bond",) else (True, words)


def _demand(command: str, given: Sequence[str], *names: str) -> None:
    missing = names[len(given) :]
    if missing:
        raise UsageError(f"{command}: {' and '.join(missing)} missing")
