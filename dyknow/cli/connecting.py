# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Connects ports to each other and to topics; all ends move, or none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Dict, List, Sequence, Tuple

from dyknow.cli.views import state_of, unknown_nodelet
from dyknow.errors import NodeletUnreachable
from dyknow.model.graph import PortRef, PortState
from dyknow.model.transformation import IN, OUT
from dyknow.similar import did_you_mean
from dyknow.wiring.ports import CannotConnect, by_name, check_ends, choose_topic
from dyknow.wiring.steps import ReversibleStep, StepFailed, carry_out

if TYPE_CHECKING:
    from dyknow.ros.shell_client import ShellClient


@dataclass(frozen=True)
class PortMove:
    """A port, its topic before the move and its topic after it; empty for disconnected."""

    port: PortRef
    before: str
    after: str


def ports_of(client: ShellClient, nodelet: str) -> Tuple[PortState, ...]:
    """Ask a nodelet for its ports.

    Raises:
        CannotConnect: there is no such nodelet, or it has no proxy.
        NodeletUnreachable: it does not answer.
    """
    try:
        return client.get_config(nodelet)
    except NodeletUnreachable as silence:
        model = client.get_graph()
        present = model.nodelet(nodelet)
        if present is None:
            raise CannotConnect(unknown_nodelet(nodelet, model)) from None
        if not present.transformation:
            raise CannotConnect(
                f"nodelet '{nodelet}' was loaded by others and has no proxy: its ports cannot be "
                "connected elsewhere"
            ) from silence
        raise NodeletUnreachable(f"{silence}; it is {state_of(present)}") from silence


def find_port(client: ShellClient, reference: PortRef) -> PortState:
    """Return the port that a reference means.

    A port that a lazy nodelet declares may be connected before the nodelet subscribes with it: its
    proxy keeps the topic until then.

    Raises:
        CannotConnect: the nodelet has no such port; its ports are named.
    """
    ports = list(ports_of(client, reference.nodelet))
    if all(port.name != reference.port for port in ports):
        shown = client.get_graph().nodelet(reference.nodelet)
        names = {port.name for port in ports}
        ports += [port for port in (shown.ports if shown else ()) if port.name not in names]
    for port in ports:
        if port.name == reference.port:
            return port
    known = ", ".join(f"{port.name} ({port.direction})" for port in ports) or "none"
    hint = did_you_mean(reference.port, [port.name for port in ports])
    raise CannotConnect(
        f"nodelet '{reference.nodelet}' has no port '{reference.port}'; its ports: {known}{hint}"
    )


def connect(
    client: ShellClient, source: PortRef, target: PortRef, topic: str = ""
) -> Tuple[str, List[PortMove]]:
    """Connect an out-port to an in-port.

    Returns:
        The topic, and the moves that were made.

    Raises:
        CannotConnect: it was refused, and both ports are as they were.
    """
    out = find_port(client, source)
    into = find_port(client, target)
    check_ends(str(source), out, str(target), into)
    topic = topic or out.topic
    if not topic:
        nodelets = client.get_graph().nodelets
        published = client.published({each.node for each in nodelets})
        topic = choose_topic(source.nodelet, out, into, nodelets, published)
    # The in-port first: it receives the first message that is published on the topic.
    changes = [
        PortMove(reference, port.topic, topic)
        for reference, port in ((target, into), (source, out))
        if port.topic != topic
    ]
    apply(client, changes)
    return topic, changes


def connect_to_topic(
    client: ShellClient, reference: PortRef, topic: str, direction: str
) -> List[PortMove]:
    """Connect a port to a topic.

    Args:
        client: the manager and its nodelets.
        reference: the port.
        topic: global name of the topic.
        direction: the direction that the port must have.

    Returns:
        The moves that were made.

    Raises:
        CannotConnect: it was refused, and the port is as it was.
    """
    nodelet = client.get_graph().nodelet(topic)
    if nodelet is not None:
        ports = ", ".join(p.name for p in by_name(nodelet.ports) if p.direction != direction)
        raise CannotConnect(
            f"'{topic}' is a nodelet; expected a topic, or its port as {topic}:PORT; its "
            f"{_other(direction)}-ports: {ports or 'none'}"
        )
    port = find_port(client, reference)
    if port.direction != direction:
        raise CannotConnect(
            f"cannot connect: '{reference}' is an {port.direction}-port; swap the two, the stream "
            "leads from the first to the second"
        )
    changes = [] if port.topic == topic else [PortMove(reference, port.topic, topic)]
    apply(client, changes)
    return changes


def _other(direction: str) -> str:
    return OUT if direction == IN else IN


def apply(client: ShellClient, moves: Sequence[PortMove]) -> None:
    """Move ports one nodelet after the other; when one fails, those before are moved back.

    Raises:
        CannotConnect: one was refused; the text says so too if one could not be moved back.
    """
    by_nodelet: Dict[str, List[PortMove]] = {}
    for move in moves:
        by_nodelet.setdefault(move.port.nodelet, []).append(move)
    try:
        carry_out([_step(client, nodelet, own) for nodelet, own in by_nodelet.items()])
    except StepFailed as failed:
        words = [f"cannot connect: {failed.error}", *failed.troubles]
        raise CannotConnect("; ".join(words)) from failed


def _step(client: ShellClient, nodelet: str, moves: Sequence[PortMove]) -> ReversibleStep:
    def move_back() -> None:
        """Move the ports back that nobody else has moved since."""
        present = {port.name: port.topic for port in client.get_config(nodelet)}
        back = {
            each.port.port: each.before
            for each in moves
            if present.get(each.port.port) == each.after
        }
        if back:
            client.set_config(nodelet, back)

    return ReversibleStep(
        f"connecting '{nodelet}'",
        nodelet,
        lambda: client.set_config(nodelet, {each.port.port: each.after for each in moves}),
        move_back,
    )
