# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`connect` and `disconnect`: the topics of ports."""

from __future__ import annotations

import argparse
from typing import Dict, List, Optional, Sequence, Union

from dyknow.cli import completion
from dyknow.cli.arguments import graph_name, port_or_topic, port_reference
from dyknow.cli.command import Command
from dyknow.cli.connecting import (
    PortMove,
    apply,
    connect,
    connect_to_topic,
    find_port,
)
from dyknow.cli.json_output import Json
from dyknow.cli.shell import Shell
from dyknow.cli.views import shows
from dyknow.model.graph import PortRef
from dyknow.model.transformation import IN, OUT
from dyknow.similar import did_you_mean


def _connect_arguments(parser: argparse.ArgumentParser) -> None:
    completion.complete_with(
        parser.add_argument(
            "source",
            metavar="FROM",
            type=port_or_topic,
            help="where the stream comes from: an out-port, NODELET:PORT, or a topic",
        ),
        completion.stream_sources,
    )
    completion.complete_with(
        parser.add_argument(
            "target",
            metavar="TO",
            type=port_or_topic,
            help="where it goes to: an in-port, NODELET:PORT, or a topic",
        ),
        completion.stream_targets,
    )
    completion.complete_with(
        parser.add_argument(
            "--topic",
            metavar="T",
            type=graph_name,
            default=None,
            help="the topic between two ports (default: the out-port's, else the in-port's, else "
            "/A/OUT)",
        ),
        completion.topics,
    )


def _connect_problem(arguments: argparse.Namespace) -> str:
    ends = arguments.source, arguments.target
    if all(isinstance(end, str) for end in ends):
        return (
            f"'{ends[0]}' and '{ends[1]}' are topics; expected a port at one end at least, "
            "NODELET:PORT, such as camera:image"
        )
    if arguments.topic and any(isinstance(end, str) for end in ends):
        return "--topic names the topic between two ports; one end is a topic already"
    return ""


def _connect(arguments: argparse.Namespace, shell: Shell) -> None:
    source, target = _end(shell, arguments.source), _end(shell, arguments.target)
    if isinstance(source, str) and isinstance(target, PortRef):
        topic, changes = source, connect_to_topic(shell.client, target, source, IN)
        _warn_without_publisher(shell, source)
    elif isinstance(source, PortRef) and isinstance(target, str):
        topic, changes = target, connect_to_topic(shell.client, source, target, OUT)
    elif isinstance(source, PortRef) and isinstance(target, PortRef):
        wish = shell.resolve(arguments.topic) if arguments.topic else ""
        topic, changes = connect(shell.client, source, target, wish)
    _wait(shell, changes)
    way = " -> ".join(dict.fromkeys((str(source), topic, str(target))))
    shell.show(
        {
            "out": _end_json(source),
            "in": _end_json(target),
            "topic": topic,
            "changed": [_change_json(change) for change in changes],
        },
        [way + ("" if changes else " (as it was)")],
    )


def _warn_without_publisher(shell: Shell, topic: str) -> None:
    """Warn when no port and no node publishes on a topic: its name may be mistyped."""
    ports = [port for nodelet in shell.client.get_graph().nodelets for port in nodelet.ports]
    sources = {port.topic for port in ports if port.direction == OUT}
    if topic not in sources:
        published = sources | shell.client.published(())
        if topic not in published:
            hint = did_you_mean(topic, published - {""})
            shell.warn(f"connected, but no node publishes on '{topic}' yet{hint}")


def _disconnect_arguments(parser: argparse.ArgumentParser) -> None:
    completion.complete_with(
        parser.add_argument(
            "ports", nargs="+", metavar="A:PORT", type=port_reference, help="a port: NODELET:PORT"
        ),
        completion.ports,
    )


def _disconnect(arguments: argparse.Namespace, shell: Shell) -> None:
    changes: List[PortMove] = []
    for reference in dict.fromkeys(_resolved(shell, each) for each in arguments.ports):
        port = find_port(shell.client, reference)
        changes.append(PortMove(reference, port.topic, ""))
    made = [change for change in changes if change.before]
    apply(shell.client, made)
    _wait(shell, made)
    shell.show(
        {"changed": [_change_json(change) for change in made]},
        [
            f"{change.port} has left {change.before}"
            if change.before
            else f"{change.port} was not connected"
            for change in changes
        ],
    )


def _end(shell: Shell, end: Union[PortRef, str]) -> Union[PortRef, str]:
    return shell.resolve(end) if isinstance(end, str) else _resolved(shell, end)


def _end_json(end: Union[PortRef, str]) -> Optional[Json]:
    return None if isinstance(end, str) else _reference_json(end)


def _resolved(shell: Shell, reference: PortRef) -> PortRef:
    return PortRef(shell.resolve(reference.nodelet), reference.port)


def _wait(shell: Shell, changes: Sequence[PortMove]) -> None:
    """Wait until the model shows the change, so that the next command sees it."""
    wanted: Dict[str, Dict[str, str]] = {}
    for change in changes:
        wanted.setdefault(change.port.nodelet, {})[change.port.port] = change.after
    if wanted and not shell.client.wait_for_model(lambda model: shows(model, wanted)):
        shell.warn("done, but the manager's model does not show it yet")


def _reference_json(reference: PortRef) -> Json:
    return {"nodelet": reference.nodelet, "port": reference.port}


def _change_json(change: PortMove) -> Json:
    return {**_reference_json(change.port), "before": change.before, "after": change.after}


COMMANDS = (
    Command(
        "connect",
        "connect ports to each other, or to topics",
        "Connect an out-port to an in-port, a topic to an in-port, or an out-port to a topic, "
        "while the nodelets run. Directions and types are checked first; of two ports the in-port "
        "is moved first, and moved back if the out-port cannot be.",
        "dyknow connect camera:image undistort:rawcamera\n"
        "dyknow connect camera:image undistort:rawcamera --topic /camera/image_raw\n"
        "dyknow connect /usb_cam/image_raw undistort:rawcamera\n"
        "dyknow connect undistort:undist /image_rect",
        _connect_arguments,
        _connect,
        _connect_problem,
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
