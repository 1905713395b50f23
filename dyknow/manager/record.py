# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets as the manager knows them: what each should be, and what was last seen."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Dict, List, Mapping, Optional, Tuple

from dyknow.manager.specifications.given import bindings_of
from dyknow.model.graph import NodeletStatus, PortState, State
from dyknow.model.transformation import Parameter, Transformation


@dataclass(frozen=True)
class Record:
    """A nodelet as the manager knows it: what it should be, and what was last seen.

    Attributes:
        name: global name.
        transformation: the blueprint it was made from, whatever the library says now; None for
            nodelets that others loaded.
        manager: nodelet manager that hosts it.
        is_protected: whether it may not be destroyed.
        isolated: whether it has a process of its own.
        rewired_by_reload: whether it is a plain C++ nodelet, which is loaded again to connect it
            elsewhere.
        topics: where its ports should be connected.
        state: whether it runs.
        detail: why it does not, in words.
        ports: what was last seen.
        claimed: made for a claim, and collected when no claim needs it.
        incarnation: of the nodelet manager when it was loaded.
        suspicion: why it was given a process of its own; empty if it is not suspected.
        unwanted: whether it should have been destroyed while its nodelet manager did not answer;
            it is destroyed as soon as that answers.
        parameters: those that were given to it, which it keeps for life.
    """

    name: str
    transformation: Optional[Transformation]
    manager: str
    is_protected: bool = False
    isolated: bool = False
    rewired_by_reload: bool = False
    topics: Mapping[str, str] = field(default_factory=dict)
    state: State = State.STARTING
    detail: str = ""
    ports: Tuple[PortState, ...] = ()
    claimed: bool = False
    incarnation: str = ""
    suspicion: str = ""
    unwanted: bool = False
    parameters: Tuple[Parameter, ...] = ()

    @cached_property
    def given(self) -> Dict[str, str]:
        """What its variables stand for in any case, since it was given at the spawn."""
        return bindings_of(self.parameters)

    @property
    def label(self) -> str:
        """Label of the transformation, empty for nodelets that others loaded."""
        return self.transformation.label if self.transformation is not None else ""

    @cached_property
    def status(self) -> NodeletStatus:
        """What others are shown of it: one value for as long as the record is the same."""
        return NodeletStatus(
            self.name,
            self.label,
            self.manager,
            self.is_protected,
            self.isolated,
            self.rewired_by_reload,
            self.state,
            self.detail,
            self.ports,
            self.parameters,
        )


def seen_ports(record: Record, ports: Tuple[PortState, ...]) -> Tuple[PortState, ...]:
    """Return the ports that a proxy reports, with the tags of the transformation."""
    declared = (
        {port.name: port for port in record.transformation.ports}
        if (record.transformation is not None)
        else {}
    )
    return tuple(
        PortState(
            port.name,
            port.direction,
            port.datatype,
            port.topic,
            declared[port.name].tags if port.name in declared else (),
        )
        for port in ports
    )


def declared_ports(record: Record) -> Tuple[PortState, ...]:
    """Return the ports of a nodelet that cannot be asked, as its transformation and topics say."""
    if record.transformation is None:
        return ()
    return tuple(
        PortState(
            port.name, port.direction, port.datatype, record.topics.get(port.name, ""), port.tags
        )
        for port in record.transformation.ports
    )


def topics_of(record: Record) -> Dict[str, str]:
    """Return the connected ports and their topics, as last seen."""
    return {port.name: port.topic for port in record.ports if port.topic}


def ports_on(record: Record, direction: str, topic: str) -> List[str]:
    """Return the names of a nodelet's ports of one direction that were seen on a topic."""
    return [
        each.name for each in record.ports if (each.direction, each.topic) == (direction, topic)
    ]
