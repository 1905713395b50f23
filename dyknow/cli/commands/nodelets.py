# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`spawn`, `destroy`, `protect` and `unprotect`."""

from __future__ import annotations

import argparse
from typing import Sequence

from dyknow.cli import completion
from dyknow.cli.arguments import SEVERAL, argument, flag
from dyknow.cli.commands.connect import PortMove, apply, find_port, meeting_topic, resolved
from dyknow.cli.output import nodelet_json
from dyknow.cli.shell import Shell, command
from dyknow.errors import DuplicatePort, UnknownTransformation
from dyknow.manager.steps import ReversibleStep, StepFailed, carry_out, spawning
from dyknow.model.graph import PortRef, PortState, SpawnRequest
from dyknow.model.hosts import AT
from dyknow.model.transformation import OUT, Transformation
from dyknow.similar import did_you_mean
from dyknow.wiring.ports import CannotConnect

_NAMES = argument("names", "NAME", "a nodelet", nargs="+")


@command(
    "Make a nodelet from a transformation. If the exit code is 0, the nodelet runs and is "
    "connected; otherwise nothing of it is left.",
    "dyknow spawn relay slow\n"
    "dyknow spawn 'undistort(cam1)' /cam1/undistort --protected\n"
    "dyknow spawn relay slow --connect in:/camera/image out:/slow/image\n"
    "dyknow spawn relay slow --connect in:camera:image\n"
    "dyknow spawn detector ball --isolated\n"
    "dyknow spawn detector ball --host rover\n"
    "dyknow spawn tracker tracker --param rate=5 '?camera=cam1'\n"
    "dyknow spawn tracker tracker _rate:=5",
    argument(
        "label",
        "LABEL",
        "the transformation to make it from",
        completer=completion.spawnable_labels,
    ),
    argument("name", "NAME", "its name", completer=None),
    flag("--protected", "refuse to destroy it before 'unprotect'"),
    flag("--isolated", "give it a process of its own"),
    argument(
        "--manager",
        "M",
        "the nodelet manager to load it into (default: the DyKnow manager's choice)",
    ),
    argument(
        "--host",
        "HOST",
        "the host to run it on, now and whenever it is brought back (default: the DyKnow "
        "manager's choice); 'dyknow list --hosts' has their names",
    ),
    argument(
        "--connect",
        "PORT:END",
        "connect its ports from the start, each to a topic or to a port, NODELET:PORT; relative "
        "topics begin in its own namespace",
        **SEVERAL,
    ),
    argument(
        "--param",
        "NAME=VALUE",
        "override parameters of the transformation; '?camera=cam1' says what ?camera "
        "in its tags and parameters stands for; _NAME:=VALUE does the same",
        **SEVERAL,
    ),
)
def _spawn(arguments: argparse.Namespace, shell: Shell) -> None:
    if arguments.host and arguments.manager:
        arguments.refuse("--host and --manager both say where it is to run; expected one of them")
    name = shell.resolve(arguments.name)
    place = shell.resolve(arguments.manager) if arguments.manager else ""
    if arguments.host:
        place = AT + arguments.host
    config: dict[str, str] = {}
    peers: list[PortMove] = []
    meets_ports = any(isinstance(end, PortRef) for _, end in arguments.connect)
    library = shell.client.get_model().transformations if meets_ports else ()
    for port, end in arguments.connect:
        if port in config:
            raise DuplicatePort(port)
        if isinstance(end, PortRef):
            own = _declared(library, arguments.label, port)
            peer, found = find_port(shell.client, resolved(shell, end))
            ends = (PortRef(name, port), own), (peer, found)
            end = meeting_topic(shell.client, *(ends if own.direction == OUT else ends[::-1]))
            if any(each.port == peer and each.after != end for each in peers):
                raise DuplicatePort(str(peer))
            peers.append(PortMove(peer, found.topic, end))
        config[port] = end
    request = SpawnRequest(
        arguments.label,
        name,
        config,
        arguments.protected,
        arguments.isolated,
        place,
        tuple(arguments.param),
    )
    back = [PortMove(each.port, each.after, each.before) for each in peers]
    connecting = ReversibleStep(
        f"connecting '{name}'",
        name,
        lambda: apply(shell.client, peers),
        lambda: apply(shell.client, back),
    )
    showing = ReversibleStep(
        f"showing '{name}'", name, lambda: show_spawned(shell, name), lambda: None
    )
    try:
        carry_out([spawning(request, shell.client), connecting, showing])
    except StepFailed as failed:
        for trouble in failed.troubles:
            if str(failed.error) not in trouble:
                shell.warn(trouble)
        raise failed.error from failed


def show_spawned(shell: Shell, name: str) -> None:
    nodelet = shell.client.get_graph().nodelet(name)
    if nodelet is None:  # it was destroyed in the meantime
        shell.show({"name": name}, [f"spawned {name}"])
        return
    connections = [f"  {port} - {topic}" for port, topic in nodelet.connections.items()]
    where = f"in {nodelet.manager}" if nodelet.manager else "in a process of its own"
    shell.show(
        nodelet_json(nodelet),
        [f"spawned {name} from {nodelet.transformation} {where}", *connections],
    )


def _declared(library: Sequence[Transformation], label: str, name: str) -> PortState:
    """Return the port that a transformation declares.

    Raises:
        UnknownTransformation: there is none of this label.
        CannotConnect: it declares no such port.
    """
    labels = [each.label for each in library]
    if label not in labels:
        raise UnknownTransformation(label, did_you_mean(label, labels))
    ports = [port for each in library if each.label == label for port in each.ports]
    for port in ports:
        if port.name == name:
            return PortState(port.name, port.direction, port.datatype)
    known = ", ".join(port.name for port in ports) or "none"
    raise CannotConnect(
        f"transformation '{label}' declares no port '{name}'; known ports: {known}"
    )


@command(
    "Destroy nodelets. A protected one is refused.",
    "dyknow destroy slow\ndyknow destroy $(dyknow list /cam1)",
    _NAMES,
)
def _destroy(arguments: argparse.Namespace, shell: Shell) -> int | None:
    names = map(shell.resolve, arguments.names)
    return shell.for_each("nodelet", "destroyed", names, shell.client.destroy)


@command("Protect nodelets from being destroyed.", "dyknow protect camera", _NAMES)
def _protect(arguments: argparse.Namespace, shell: Shell) -> int | None:
    return _set_protection(arguments, shell, True)


@command("Let protected nodelets be destroyed again.", "dyknow unprotect camera", _NAMES)
def _unprotect(arguments: argparse.Namespace, shell: Shell) -> int | None:
    return _set_protection(arguments, shell, False)


def _set_protection(arguments: argparse.Namespace, shell: Shell, value: bool) -> int | None:
    done, names = f"{arguments.command}ed", map(shell.resolve, arguments.names)
    return shell.for_each(
        "nodelet", done, names, lambda name: shell.client.set_protection(name, value)
    )
