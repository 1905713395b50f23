"""`connect` and `disconnect`: which topics the ports are on."""

from __future__ import annotations

import argparse
from typing import Dict, List, Sequence

from dyknow.cli.arguments import Kind, PortReference, graph_name, port_reference, takes
from dyknow.cli.command import Command
from dyknow.cli.connecting import Change, apply, connect, find_port, ports_of
from dyknow.cli.shapes import Shape
from dyknow.cli.shell import Shell
from dyknow.cli.views import shows


def _connect_arguments(parser: argparse.ArgumentParser) -> None:
    takes(
        parser.add_argument(
            "source", metavar="A:OUT", type=port_reference, help="an out-port: NODELET:PORT"
        ),
        Kind.OUT_PORT,
    )
    takes(
        parser.add_argument(
            "target", metavar="B:IN", type=port_reference, help="an in-port: NODELET:PORT"
        ),
        Kind.IN_PORT,
    )
    takes(
        parser.add_argument(
            "--topic",
            metavar="T",
            type=graph_name,
            default=None,
            help="the topic to use (default: the out-port's, else the in-port's, else /A/OUT)",
        ),
        Kind.TOPIC,
    )


def _connect(arguments: argparse.Namespace, shell: Shell) -> None:
    source = _resolved(shell, arguments.source)
    target = _resolved(shell, arguments.target)
    topic = shell.resolve(arguments.topic) if arguments.topic else ""
    topic, changes = connect(shell.client, source, target, topic)
    _wait(shell, changes)
    shell.show(
        {
            "out": _reference_shape(source),
            "in": _reference_shape(target),
            "topic": topic,
            "changed": [_change_shape(change) for change in changes],
        },
        [f"{source} -> {topic} -> {target}" + ("" if changes else " (as it was)")],
    )


def _disconnect_arguments(parser: argparse.ArgumentParser) -> None:
    takes(
        parser.add_argument(
            "ports", nargs="+", metavar="A:PORT", type=port_reference, help="a port: NODELET:PORT"
        ),
        Kind.PORT,
    )


def _disconnect(arguments: argparse.Namespace, shell: Shell) -> None:
    changes: List[Change] = []
    for reference in dict.fromkeys(_resolved(shell, each) for each in arguments.ports):
        port = find_port(reference, ports_of(shell.client, reference.nodelet))
        changes.append(Change(reference, port.topic, ""))
    made = [change for change in changes if change.before]
    apply(shell.client, made)
    _wait(shell, made)
    shell.show(
        {"changed": [_change_shape(change) for change in made]},
        [
            f"{change.port} has left {change.before}"
            if change.before
            else f"{change.port} was not connected"
            for change in changes
        ],
    )


def _resolved(shell: Shell, reference: PortReference) -> PortReference:
    return PortReference(shell.resolve(reference.nodelet), reference.port)


def _wait(shell: Shell, changes: Sequence[Change]) -> None:
    """Let the manager see the change, so that the next command does too."""
    wanted: Dict[str, Dict[str, str]] = {}
    for change in changes:
        wanted.setdefault(change.port.nodelet, {})[change.port.port] = change.after
    if wanted and not shell.client.wait_for_model(lambda model: shows(model, wanted)):
        shell.warn("done, but the manager's model does not show it yet")


def _reference_shape(reference: PortReference) -> Shape:
    return {"nodelet": reference.nodelet, "port": reference.port}


def _change_shape(change: Change) -> Shape:
    return {**_reference_shape(change.port), "before": change.before, "after": change.after}


COMMANDS = (
    Command(
        "connect",
        "connect an out-port to an in-port",
        "Connect an out-port to an in-port while both nodelets run. Directions and types are "
        "checked first; the in-port is moved first, and moved back if the out-port cannot be.",
        "dyknow connect camera:image undistort:rawcamera\n"
        "dyknow connect camera:image undistort:rawcamera --topic /camera/image_raw",
        _connect_arguments,
        _connect,
    ),
    Command(
        "disconnect",
        "disconnect ports",
        "Disconnect ports from their topics while their nodelets run.",
        "dyknow disconnect undistort:rawcamera\n"
        "dyknow disconnect camera:image undistort:rawcamera",
        _disconnect_arguments,
        _disconnect,
    ),
)
