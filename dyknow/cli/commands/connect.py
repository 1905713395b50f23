# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`connect` and `disconnect`: the topics of ports; all ends move, or none."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING, Sequence

from dyknow import names
from dyknow.cli import completion
from dyknow.cli.arguments import argument, port_or_topic
from dyknow.cli.output import Json, as_json, picked, state_of, unknown_nodelet
from dyknow.cli.shell import Shell, command
from dyknow.errors import FixedTopics, NodeletUnreachable, Refused
from dyknow.model.graph import PortRef, PortState
from dyknow.model.transformation import IN, OUT
from dyknow.similar import did_you_mean
from dyknow.wiring.ports import CannotConnect, by_name, check_ends, choose_topic

if TYPE_CHECKING:
    from dyknow.ros.shell.shell_client import ShellClient


@dataclass(frozen=True)
class PortMove:
    """A port, its topic before the move and its topic after it; empty for disconnected."""

    port: PortRef
    before: str
    after: str


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


@command(
    "connect",
    "connect ports to each other, or to topics",
    "Connect an out-port to an in-port, a topic to an in-port, or an out-port to a topic, "
    "while the nodelets run. Directions and types are checked first; of two ports the in-port "
    "is moved first, and moved back if the out-port cannot be.",
    "dyknow connect camera:image undistort:rawcamera\n"
    "dyknow connect camera:image undistort:rawcamera --topic /camera/image_raw\n"
    "dyknow connect /usb_cam/image_raw undistort:rawcamera\n"
    "dyknow connect undistort:undist /image_rect",
    argument(
        "source",
        "FROM",
        "where the stream comes from: an out-port, NODELET:PORT, or a topic",
        completer=completion.stream_sources,
        type=port_or_topic,
    ),
    argument(
        "target",
        "TO",
        "where it goes to: an in-port, NODELET:PORT, or a topic",
        completer=completion.stream_targets,
        type=port_or_topic,
    ),
    argument(
        "--topic",
        "T",
        "the topic between two ports (default: the out-port's, else the in-port's, else /A/OUT)",
    ),
    problem=_connect_problem,
)
def _connect(arguments: argparse.Namespace, shell: Shell) -> None:
    source, target = _end(shell, arguments.source), _end(shell, arguments.target)
    if isinstance(source, str) and isinstance(target, PortRef):
        topic, moves = source, _connect_to_topic(shell.client, target, source, IN)
        published, _ = shell.client.topics_in_use()
        if topic not in published:  # its name may be mistyped
            hint = did_you_mean(topic, published)
            shell.warn(f"connected, but no node publishes on '{topic}' yet{hint}")
    elif isinstance(source, PortRef) and isinstance(target, str):
        topic, moves = target, _connect_to_topic(shell.client, source, target, OUT)
    elif isinstance(source, PortRef) and isinstance(target, PortRef):
        wish = shell.resolve(arguments.topic) if arguments.topic else ""
        topic, moves = _connect_ports(shell.client, source, target, wish)
    way = " -> ".join(dict.fromkeys((str(source), topic, str(target))))
    shell.show(
        {
            "out": None if isinstance(source, str) else as_json(source),
            "in": None if isinstance(target, str) else as_json(target),
            "topic": topic,
            "changed": [_move_json(move) for move in moves],
        },
        [way + ("" if moves else " (as it was)")],
    )


def _connect_ports(
    client: ShellClient, source: PortRef, target: PortRef, topic: str
) -> tuple[str, list[PortMove]]:
    """Connect an out-port to an in-port; return the topic, and the moves that were made."""
    out, into = find_port(client, source), find_port(client, target)
    check_ends(str(source), out, str(target), into)
    topic = topic or out.topic or _free_topic(client, source.nodelet, out, into)
    # The in-port first: it receives the first message that is published on the topic.
    ends = (PortMove(target, into.topic, topic), PortMove(source, out.topic, topic))
    return topic, apply(client, ends)


def meeting_topic(client: ShellClient, name: str, port: PortState, peer: PortRef) -> PortMove:
    """Choose the topic of a port of a nodelet that is to be spawned, and of its peer's.

    Raises:
        CannotConnect: the peer does not exist, or the two do not fit.
    """
    found = find_port(client, peer)
    own = PortRef(name, port.name)
    if port.direction == IN:
        check_ends(str(peer), found, str(own), port)
        topic = found.topic or _free_topic(client, peer.nodelet, found, port)
    else:
        check_ends(str(own), port, str(peer), found)
        topic = _free_topic(client, name, port, found)
    return PortMove(peer, found.topic, topic)


def _free_topic(client: ShellClient, nodelet: str, out: PortState, into: PortState) -> str:
    published, heard = client.topics_in_use()
    taken: set[str] = set()
    if names.topic_after(nodelet, out.name) in heard | published:  # perhaps by a port
        graph = client.get_graph()
        taken = {port.topic for each in graph.nodelets for port in each.ports}
    return choose_topic(nodelet, out, into, published, taken)


def _connect_to_topic(
    client: ShellClient, reference: PortRef, topic: str, direction: str
) -> list[PortMove]:
    """Connect a port of this direction to a topic; return the moves that were made."""
    nodelet = client.get_graph().nodelet(topic) if client.is_nodelet(topic) else None
    if nodelet is not None:
        other = OUT if direction == IN else IN
        ports = ", ".join(p.name for p in by_name(nodelet.ports) if p.direction == other)
        raise CannotConnect(
            f"'{topic}' is a nodelet; expected a topic, or its port as {topic}:PORT; its "
            f"{other}-ports: {ports or 'none'}"
        )
    port = find_port(client, reference)
    if port.direction != direction:
        raise CannotConnect(
            f"cannot connect: '{reference}' is an {port.direction}-port; swap the two, the stream "
            "leads from the first to the second"
        )
    return apply(client, [PortMove(reference, port.topic, topic)])


@command(
    "disconnect",
    "disconnect ports",
    "Disconnect ports from their topics while their nodelets run.",
    "dyknow disconnect undistort:rawcamera\ndyknow disconnect camera:image undistort:rawcamera",
    argument("ports", "A:PORT", "a port: NODELET:PORT", nargs="+"),
)
def _disconnect(arguments: argparse.Namespace, shell: Shell) -> None:
    references = dict.fromkeys(resolved(shell, each) for each in arguments.ports)
    wanted = [PortMove(each, find_port(shell.client, each).topic, "") for each in references]
    moves = apply(shell.client, wanted)
    left = (f"has left {move.before}" if move.before else "was not connected" for move in wanted)
    shell.show(
        {"changed": [_move_json(move) for move in moves]},
        [f"{move.port} {what}" for move, what in zip(wanted, left)],
    )


def _ports_of(client: ShellClient, nodelet: str) -> tuple[PortState, ...]:
    """Ask a nodelet for its ports.

    Raises:
        CannotConnect: the nodelet does not exist, or its topics are fixed.
        NodeletUnreachable: it does not answer.
    """
    try:
        return client.get_config(nodelet)
    except NodeletUnreachable as silence:
        model = client.get_graph()
        present = model.nodelet(nodelet)
        if present is None:
            raise CannotConnect(unknown_nodelet(nodelet, model)) from None
        if present.is_fixed:
            raise CannotConnect(str(FixedTopics(nodelet, present.manager))) from silence
        raise NodeletUnreachable(f"{silence}; it is {state_of(present)}") from silence


def find_port(client: ShellClient, reference: PortRef) -> PortState:
    """Return the port that a reference means.

    A port that a lazy nodelet declares may be connected before the nodelet subscribes with it: its
    proxy keeps the topic until then.

    Raises:
        CannotConnect: the nodelet has no such port; its ports are named.
    """
    ports = list(_ports_of(client, reference.nodelet))
    found = [port for port in ports if port.name == reference.port]
    if not found:
        shown = client.get_graph().nodelet(reference.nodelet)
        present = {port.name for port in ports}
        ports += [port for port in (shown.ports if shown else ()) if port.name not in present]
        found = [port for port in ports if port.name == reference.port]
    if found:
        return found[0]
    known = ", ".join(f"{port.name} ({port.direction})" for port in ports) or "none"
    hint = did_you_mean(reference.port, [port.name for port in ports])
    raise CannotConnect(
        f"nodelet '{reference.nodelet}' has no port '{reference.port}'; its ports: {known}{hint}"
    )


def apply(client: ShellClient, wanted: Sequence[PortMove]) -> list[PortMove]:
    """Move ports in this order, all or none; return the moves that were needed.

    Raises:
        CannotConnect: one was refused; the text says so if one could not be moved back.
    """
    moves = [move for move in wanted if move.before != move.after]
    by_nodelet: dict[str, dict[str, str]] = {}
    for move in moves:
        by_nodelet.setdefault(move.port.nodelet, {})[move.port.port] = move.after
    if moves:
        try:
            client.connect(list(by_nodelet.items()))
        except Refused as error:
            raise CannotConnect(f"cannot connect: {error}") from error
    return moves


def _end(shell: Shell, end: PortRef | str) -> PortRef | str:
    return shell.resolve(end) if isinstance(end, str) else resolved(shell, end)


def resolved(shell: Shell, reference: PortRef) -> PortRef:
    return PortRef(shell.resolve(reference.nodelet), reference.port)


def _move_json(move: PortMove) -> Json:
    return {**picked(move.port, "nodelet port"), **picked(move, "before after")}
