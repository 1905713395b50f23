# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`rosrun dyknow nodelet`, argument by argument the command line of nodelet_core.

A manager or standalone process of this command hosts nodelets in Python; as a client (`load`,
`unload`) it serves managers in Python and in C++. Launch files written for `pkg="nodelet"
type="nodelet"` work with another package name, so nothing is added between the stock arguments,
and everything behind them goes to the nodelet as its `my_argv`.
"""

from __future__ import annotations

import re
import sys
from typing import NamedTuple, Sequence, Tuple

if __name__ == "__main__":
    import dyknow.interruptible  # noqa: F401
from dyknow.cli.node_help import HELP, NODELET_MANAGER
from dyknow.errors import CannotRun
from dyknow.ros.process.signals import DONE, FAILED, INTERRUPTED

SCRIPT_TYPE = "dyknow/Script"  # the nodelet that runs scripts
#: The words that each command demands.
_WORDS: dict[str, tuple[str, ...]] = {
    "manager": (),
    "load": ("PKG/CLASS", "MANAGER"),
    "load_script": ("PKG", "SCRIPT", "MANAGER"),
    "standalone": ("PKG/CLASS",),
    "standalone_script": ("PKG", "SCRIPT"),
    "unload": ("NAME", "MANAGER"),
}

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


class NodeletCommand(NamedTuple):
    """A command line that was read."""

    action: str  # `load` for `load_script`, too; `help`
    type: str = ""  # the nodelet's class; for `standalone_script` the script, PKG/SCRIPT
    name: str = ""  # of the nodelet to unload, or of one that was given none
    manager: str = ""
    bond: bool = True  # whether the nodelet and this command watch each other
    my_argv: Tuple[str, ...] = ()


def parse(arguments: Sequence[str]) -> NodeletCommand:
    """Parse all but the program's name; ROS's own words (`a:=b`) may stand anywhere.

    Raises:
        UsageError: the command is unknown, or something is missing.
    """
    words = tuple(word for word in arguments if ":=" not in word)
    if HELP.intersection(words[:2]):
        return NodeletCommand("help")
    if not words:
        raise UsageError("a command is missing")
    action, words = words[0], words[1:]
    if action not in _WORDS:
        raise UsageError(f"there is no command '{action}'")
    demanded = _WORDS[action]
    missing = demanded[len(words) :]
    if missing:
        raise UsageError(f"{action}: {' and '.join(missing)} missing")
    given, rest = dict(zip(demanded, words)), words[len(demanded) :]
    manager, kind = given.get("MANAGER", ""), given.get("PKG/CLASS", "")
    script = f"{given['PKG']}/{given['SCRIPT']}" if "SCRIPT" in given else ""
    if action == "unload":
        return NodeletCommand(action, name=given["NAME"], manager=manager)
    if "MANAGER" not in given:
        return NodeletCommand(action, kind or script, my_argv=rest)
    bond = rest[:1] != ("--no-bond",)
    rest = rest if bond else rest[1:]
    if kind:
        return NodeletCommand(action, kind, kind.replace("/", "_"), manager, bond, rest)
    name = re.sub(r"\W", "_", script.rpartition("/")[2].partition(".")[0])
    return NodeletCommand("load", SCRIPT_TYPE, name, manager, bond, (script, *rest))


def main(argv: Sequence[str] | None = None) -> int:
    """Run `nodelet` with a command line, by default the process's, and return its exit code."""
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
    except CannotRun as error:
        print(f"nodelet: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        return INTERRUPTED


def manager_main(argv: Sequence[str] | None = None) -> int:
    """Run `nodelet_manager`, which is `nodelet manager`, and return its exit code."""
    argv = list(sys.argv if argv is None else argv)
    if HELP.intersection(argv[1:]):
        print(NODELET_MANAGER, end="")
        return DONE
    return main([argv[0], "manager", *argv[1:]])


def _run(command: NodeletCommand, argv: Sequence[str]) -> int:
    # Each command has its own imports: --help and a wrong usage do not wait for rospy.
    if command.action == "help":
        print(USAGE, end="")
        return DONE
    if command.action == "standalone_script":
        from dyknow.cli.rewirable import become_script
        from dyknow.ros.process.programs import find_script

        remappings = [word for word in argv if ":=" in word]
        become_script([find_script(command.type), *command.my_argv, *remappings])
    import dyknow.ros.lean  # noqa: F401

    if command.action in ("load", "unload"):
        from dyknow.ros.nodelets import nodelet_client

        if command.action == "unload":
            return nodelet_client.run_unload(command.name, command.manager, argv)
        return nodelet_client.run_load(
            command.name, command.type, command.manager, command.my_argv, command.bond, argv
        )
    from dyknow.ros.nodelets import nodelet_manager

    if command.action == "manager":
        return nodelet_manager.run_manager(argv)
    print(f"type is {command.type}", flush=True)
    return nodelet_manager.run_standalone(command.type, command.my_argv, argv)


if __name__ == "__main__":
    sys.exit(main())
