# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`connect` and `disconnect`: the topics of ports; all ends move, or none."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING, Sequence

from dyknow import names
from dyknow.cli.arguments import argument
from dyknow.cli.output import Json, as_json, picked, state_of, unknown_nodelet
from dyknow.cli.shell import Shell, command
from dyknow.errors import FixedTopics, NodeletUnreachable, PeerTimeout, Refused
from dyknow.model.graph import PortRef, PortState, State
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


@command(
    "Connect an out-port to an in-port, a topic to an in-port, or an out-port to a topic, "
    "while the nodelets run. Directions and types are checked first; of two ports the in-port "
    "is moved first, and moved back if the out-port cannot be.",
    "dyknow connect camera:image undistort:rawcamera\n"
    "dyknow connect camera:image undistort:rawcamera --topic /camera/image_raw\n"
    "dyknow connect /usb_cam/image_raw undistort:rawcamera\n"
    "dyknow connect undistort:undist /image_rect",
    argument(
        "source", "FROM", "where the stream comes from: an out-port, NODELET:PORT, or a topic"
    ),
    argument("target", "TO", "where it goes to: an in-port, NODELET:PORT, or a topic"),
    argument(
        "--topic",
        "T",
        "the topic between two ports (default: the out-port's, else the in-port's, else /A/OUT)",
    ),
)
def _connect(arguments: argparse.Namespace, shell: Shell) -> None:
    ends = arguments.source, arguments.target
    topics = [end for end in ends if isinstance(end, str)]
    if len(topics) == 2:
        arguments.refuse(
            f"'{topics[0]}' and '{topics[1]}' are topics; expected a port at one end at least, "
            "NODELET:PORT, such as camera:image"
        )
    if arguments.topic and topics:
        arguments.refuse("--topic names the topic between two ports; one end is a topic already")
    client = shell.client
    source, target = (None if isinstance(end, str) else resolved(shell, end) for end in ends)
    if source and target:
        (source, out), (target, into) = find_port(client, source), find_port(client, target)
        wish = shell.resolve(arguments.topic) if arguments.topic else ""
        topic = meeting_topic(client, (source, out), (target, into), wish)
        # The in-port first: it receives the first message that is published on the topic.
        wanted = [PortMove(target, into.topic, topic), PortMove(source, out.topic, topic)]
    else:
        topic = shell.resolve(topics[0])
        given = ((source, OUT), (target, IN))
        wanted = [_move_to_topic(client, port, topic, way) for port, way in given if port]
        source, target = (port and wanted[0].port for port, _ in given)
    moves = apply(client, wanted)
    if source is None and topic not in (published := client.topics_in_use()[0]):
        hint = did_you_mean(topic, published)  # its name may be mistyped
        shell.warn(f"connected, but no node publishes on '{topic}' yet{hint}")
    way = " -> ".join(dict.fromkeys((str(source or topic), topic, str(target or topic))))
    shell.show(
        {
            "out": as_json(source),
            "in": as_json(target),
            "topic": topic,
            "changed": [_move_json(move) for move in moves],
        },
        [way + ("" if moves else " (as it was)")],
    )


def meeting_topic(
    client: ShellClient,
    source: tuple[PortRef, PortState],
    target: tuple[PortRef, PortState],
    wish: str = "",
) -> str:
    """Choose the topic of an out-port and an in-port; raises CannotConnect if they do not fit."""
    (reference, out), (peer, into) = source, target
    check_ends(str(reference), out, str(peer), into)
    if wish or out.topic:
        return wish or out.topic
    published, heard = client.topics_in_use()
    taken: set[str] = set()
    if names.topic_after(reference.nodelet, out.name) in heard | published:  # perhaps by a port
        graph = client.get_graph()
        taken = {port.topic for each in graph.nodelets for port in each.ports}
    return choose_topic(reference.nodelet, out, into, published, taken)


def _move_to_topic(
    client: ShellClient, reference: PortRef, topic: str, direction: str
) -> PortMove:
    """Prepare to connect a port of this direction to a topic."""
    nodelet = client.get_graph().nodelet(topic) if client.is_nodelet(topic) else None
    if nodelet is not None and not any(topic in each for each in client.topics_in_use()):
        other = OUT if direction == IN else IN
        ports = ", ".join(p.name for p in by_name(nodelet.ports) if p.direction == other)
        raise CannotConnect(
            f"'{topic}' is a nodelet; expected a topic, or its port as {topic}:PORT; its "
            f"{other}-ports: {ports or 'none'}"
        )
    reference, port = find_port(client, reference)
    if port.direction != direction:
        raise CannotConnect(
            f"cannot connect: '{reference}' is an {port.direction}-port; swap the two, the stream "
            "leads from the first to the second"
        )
    return PortMove(reference, port.topic, topic)


@command(
    "Disconnect ports from their topics while their nodelets run.",
    "dyknow disconnect undistort:rawcamera\ndyknow disconnect camera:image undistort:rawcamera",
    argument("ports", "A:PORT", "a port: NODELET:PORT", nargs="+"),
)
def _disconnect(arguments: argparse.Namespace, shell: Shell) -> None:
    references = dict.fromkeys(resolved(shell, each) for each in arguments.ports)
    found = [find_port(shell.client, each) for each in references]
    wanted = [PortMove(each, port.topic, "") for each, port in found]
    moves = apply(shell.client, wanted)
    left = (f"has left {move.before}" if move.before else "was not connected" for move in wanted)
    shell.show(
        {"changed": [_move_json(move) for move in moves]},
        [f"{move.port} {what}" for move, what in zip(wanted, left)],
    )


def find_port(client: ShellClient, reference: PortRef) -> tuple[PortRef, PortState]:
    """Return the port that a reference means, with its full name: of ``in`` perhaps ``~in``.

    A port that a lazy nodelet declares may be connected before the nodelet subscribes with it: its
    proxy keeps the topic until then.

    Raises:
        CannotConnect: the nodelet does not exist, its topics are fixed, or it has no such port.
        NodeletUnreachable: it does not answer.
    """
    name = reference.nodelet
    ports = _ports_of(client, name)
    if reference.port not in ports:
        shown = client.get_graph().nodelet(name)
        for port in shown.ports if shown else ():
            ports.setdefault(port.name, port)
    alike = [port for port in ports if port.lstrip("~/") == reference.port]
    if reference.port in ports or len(alike) == 1:
        port = ports.get(reference.port) or ports[alike[0]]
        return PortRef(name, port.name), port
    known = ", ".join(f"{port.name} ({port.direction})" for port in ports.values()) or "none"
    hint = did_you_mean(reference.port, ports)
    raise CannotConnect(
        f"nodelet '{name}' has no port '{reference.port}'; its ports: {known}{hint}"
    )


def _ports_of(client: ShellClient, name: str, again: bool = True) -> dict[str, PortState]:
    """Return the ports of a nodelet; of one that is being restarted or moved, those in the model.

    The manager waits for it. ``again`` asks a second time where it is back by then.
    """
    try:
        return {port.name: port for port in client.get_config(name)}
    except (NodeletUnreachable, Refused) as silence:
        model = client.get_graph()
        shown = model.nodelet(name)
        if shown is None:
            raise CannotConnect(unknown_nodelet(name, model)) from None
        if shown.is_fixed:
            raise CannotConnect(str(FixedTopics(name, shown.manager))) from silence
        if shown.state is State.STARTING and shown.ports:
            return {port.name: port for port in shown.ports}
        if not again or isinstance(silence.__cause__, PeerTimeout):
            raise NodeletUnreachable(f"{silence}; it is {state_of(shown)}") from silence
    return _ports_of(client, name, again=False)


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


def resolved(shell: Shell, reference: PortRef) -> PortRef:
    return PortRef(shell.resolve(reference.nodelet), reference.port)


def _move_json(move: PortMove) -> Json:
    return {**picked(move.port, "nodelet port"), **picked(move, "before after")}
