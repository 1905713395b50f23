# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which ports fit together, and the topics on which they meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Container, Iterable, Sequence

from dyknow import names
from dyknow.datatypes import ANY, types_fit
from dyknow.errors import DyKnowError
from dyknow.model.graph import NodeletStatus, PortRef, PortState
from dyknow.model.transformation import IN, OUT


def by_name(ports: Iterable[PortState]) -> list[PortState]:
    """Sort ports: the manager shows them in the order in which the nodelet made them."""
    return sorted(ports, key=lambda port: port.name)


class CannotConnect(DyKnowError):
    """Ports or topics cannot be connected; the text says why."""


def check_ends(source: str, out: PortState, target: str, into: PortState) -> None:
    """Raise CannotConnect with everything that does not fit about two ports.

    ``source`` and ``target`` are their names, `NODELET:PORT`.
    """
    problems: list[str] = []
    if out.direction != OUT:
        problems.append(f"'{source}' is an in-port, expected an out-port first")
    if into.direction != IN:
        problems.append(f"'{target}' is an out-port, expected an in-port second")
    if len(problems) == 2:
        problems = [f"'{source}' is an in-port and '{target}' an out-port; swap the two"]
    if not types_fit(out.datatype, into.datatype):
        problems.append(f"'{source}' carries {out.datatype}, '{target}' expects {into.datatype}")
    if problems:
        raise CannotConnect(f"cannot connect: {'; '.join(problems)}")


def choose_topic(
    nodelet: str,
    out: PortState,
    into: PortState,
    published: Container[str],
    taken: Container[str] = (),
) -> str:
    """Choose the topic on which an out-port and an in-port meet.

    It is the one that the out-port publishes on already, so that other listeners keep their
    stream; else the in-port's, unless something else publishes there; else one that is named after
    the out-port: the in-port receives from the out-port, and from nothing else. Topics are
    ``published`` by ports and ordinary nodes, and ``taken`` by ports that are connected to them.
    """
    if out.topic:
        return out.topic
    if into.topic and into.topic not in published:
        return into.topic
    return names.free_topic(nodelet, out.name, lambda topic: topic in published or topic in taken)


@dataclass(frozen=True)
class Topic:
    """A topic that ports are connected to."""

    name: str  # global name
    datatype: str  # ROS type, empty when no port knows it
    sources: tuple[PortRef, ...]  # out-ports that publish on it, sorted
    targets: tuple[PortRef, ...]  # in-ports that receive from it, sorted
    tags: tuple[str, ...] = ()  # of the out-ports, sorted


def topics_of(nodelets: Iterable[NodeletStatus]) -> list[Topic]:
    """List the topics that nodelets are connected to, by name."""
    ends: dict[str, list[tuple[PortRef, PortState]]] = {}
    for nodelet in sorted(nodelets, key=lambda each: each.name):
        for port in by_name(nodelet.ports):
            if port.topic:
                ends.setdefault(port.topic, []).append((PortRef(nodelet.name, port.name), port))
    return [_topic(name, ends[name]) for name in sorted(ends)]


def _topic(name: str, ends: Sequence[tuple[PortRef, PortState]]) -> Topic:
    types = (port.datatype for _, port in ends if port.datatype not in ANY)
    out_ports = [port for _, port in ends if port.direction == OUT]
    return Topic(
        name,
        next(types, ""),
        tuple(ref for ref, port in ends if port.direction == OUT),
        tuple(ref for ref, port in ends if port.direction != OUT),
        tuple(sorted({tag for port in out_ports for tag in port.tags})),
    )
