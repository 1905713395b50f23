# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Records of nodelets: their desired and their last observed state."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Container, Dict, Iterable, List, Mapping, NamedTuple, Optional, Tuple

from dyknow import names
from dyknow.errors import UnknownNodelet
from dyknow.manager.bodies import pack, read_fields, unpack
from dyknow.manager.specifications.given import bindings_of, set_on_load
from dyknow.manager.specifications.tags import Bindings
from dyknow.model.graph import NodeletKind, NodeletStatus, PortState, State, moved_ports
from dyknow.model.transformation import IN, Parameter, Port, Transformation


class Heard(NamedTuple):
    """Values of a nodelet's variables in the messages that it has received.

    It may remember them, even if nothing sends there any more, until it is reconfigured.
    """

    #: Its in-ports with variables, and their topics.
    topics: Tuple[Tuple[str, Tuple[str, ...]], ...] = ()
    ways: Tuple[Bindings, ...] = ()  # bindings of its variables, all that agree with its messages


NOTHING_HEARD = Heard()
"""A nodelet has received nothing that binds a variable."""

UNSURE = "?"
"""Incarnation of a nodelet that may be loaded or not; a spawn that never returned has none."""


@dataclass(frozen=True)
class Record:
    """The desired and the last observed state of a nodelet."""

    name: str  # global name
    #: The blueprint of a spawned nodelet, even if the library has changed since; the description
    #: of an external node; None for other external nodelets.
    transformation: Optional[Transformation]
    manager: str  # nodelet manager that hosts it; a node hosts itself
    is_protected: bool = False  # whether it may not be destroyed
    isolated: bool = False  # whether it has a process of its own
    #: Whether its ports stay on their topics: a C++ nodelet without live ports.
    is_fixed: bool = False
    topics: Mapping[str, str] = field(default_factory=dict)  # desired connections, by port
    state: State = State.STARTING  # whether it runs
    detail: str = ""  # the reason for the state, for people
    ports: Tuple[PortState, ...] = ()  # as last observed
    claimed: bool = False  # made for a claim, and collected when no claim needs it
    incarnation: str = ""  # of its process when it was loaded
    suspicion: str = ""  # why it was isolated; empty if it is not suspected of crashes
    unwanted: bool = False  # whether it has to be destroyed as soon as its nodelet manager answers
    #: Whether it has to be unloaded as soon as that answers, and loaded again.
    superseded: bool = False
    parameters: Tuple[Parameter, ...] = ()  # from the spawn, for life
    kind: NodeletKind = NodeletKind.PYTHON  # kind of nodelet or node
    host: str = ""  # its machine, as ROS names it
    pinned: str = ""  # the machine that its spawn named, where it is for life; empty for any
    heard: Heard = NOTHING_HEARD  # values of its variables in its messages
    #: Ports that claims have moved, and the topics where users had them, empty if nowhere.
    cut: Tuple[Tuple[str, str], ...] = ()
    awaited: Tuple[str, ...] = ()  # declared ports that it has not made yet, or not at present
    #: A text that differs when its files do, as they were when it was loaded; empty if unknown.
    code: str = ""
    outdated: str = ""  # why a restart would make it differently; empty if it would not
    #: The node that had it loaded, or else its process; empty for a spawned nodelet.
    owner: str = ""

    @cached_property
    def given(self) -> Dict[str, str]:
        """Values of its variables that its parameters fix."""
        return bindings_of(self.parameters)

    @property
    def is_spawned(self) -> bool:
        return self.transformation is not None and not self.transformation.node

    @property
    def is_described(self) -> bool:
        """True for an external node that the library describes."""
        return self.transformation is not None and bool(self.transformation.node)

    @property
    def is_stored(self) -> bool:
        """Whether it outlives the manager: external ones only with what nothing else shows."""
        return self.is_spawned or bool(self.cut or (self.is_described and self.heard.ways))

    @property
    def is_ending(self) -> bool:
        """Whether an unload of it may still be on its way, and is made certain."""
        return self.unwanted or self.superseded

    @property
    def owed(self) -> Dict[str, str]:
        """Its ports that can be moved back to where users had them, with the topics of these."""
        if not self.cut or self.is_fixed:
            return {}
        present = {port.name: port.topic for port in self.ports}
        return {port: topic for port, topic in self.cut if present.get(port, topic) != topic}

    @property
    def is_complete(self) -> bool:
        """Whether each of its declared ports was seen."""
        return {port.name for port in self.declared} <= {port.name for port in self.ports}

    @property
    def declared(self) -> Tuple[Port, ...]:
        """The ports of its transformation."""
        return self.transformation.ports if self.transformation is not None else ()

    @property
    def label(self) -> str:
        """Label of the transformation, empty for external nodelets without a description."""
        return self.transformation.label if self.transformation is not None else ""

    @cached_property
    def status(self) -> NodeletStatus:
        """Its public status: one value for as long as the record is the same.

        Ports that are not known now are shown as they are to be connected.
        """
        ports = self.ports or (declared_ports(self) if self.is_spawned else ())
        return NodeletStatus(
            self.name,
            self.label,
            "" if self.kind.is_node else self.manager,
            self.is_protected,
            self.isolated,
            self.is_fixed,
            self.state,
            "; ".join(filter(None, (self.detail, self.outdated))),
            ports,
            self.parameters,
            self.kind,
            self.host,
            self.owner,
        )

    def body(self) -> str:
        """Return its stored form, as JSON."""
        body = {name: getattr(self, name) for name in _STORED}
        for name in ("heard", "cut", "code", "pinned", "superseded"):
            if body[name] == getattr(Record, name):  # the default
                del body[name]  # earlier versions do not read it
        body["transformation"] = pack(self.transformation) if self.transformation else None
        body.update(topics=dict(self.topics), state=int(self.state), kind=self.kind.value)
        return json.dumps(body, sort_keys=True)

    @classmethod
    def from_body(cls, name: str, text: str) -> Record:
        """Read what ``body`` returned; one of the errors that ``Store.read`` expects if it is not.

        Earlier versions did not write all fields.
        """
        body = dict(json.loads(text))
        made_from = body.pop("transformation")
        if "is_fixed" not in body:  # its name in earlier versions, which did not write the kind
            body["is_fixed"] = body.pop("rewired_by_reload")
        plain = NodeletKind.CPP if body["is_fixed"] else NodeletKind.PYTHON
        fields_ = read_fields(cls, {"kind": plain.value, **body})
        record = cls(name, unpack(made_from) if made_from else None, **fields_)
        if names.check(name, "nodelet name") != name or name[:1] != "/":
            raise ValueError("its name is not global")
        if record.transformation is not None:
            set_on_load(record.transformation, record.parameters)
        return record


#: The fields that are stored, besides the key; the others are observations of each life.
_OBSERVED = ("name", "ports", "awaited", "outdated", "owner")
_STORED = tuple(each.name for each in fields(Record) if each.name not in _OBSERVED)


class Records(Dict[str, Record]):
    """Records by name; of one that is not there, UnknownNodelet is raised."""

    def __missing__(self, name: str) -> Record:
        raise UnknownNodelet(name, self)


def seen_ports(record: Record, ports: Tuple[PortState, ...]) -> Tuple[PortState, ...]:
    """Return the ports that a proxy reports, with the tags of the transformation.

    A nodelet that was not written for DyKnow may have declared ports that its proxy does not
    report, or only with the topic: a lazy one subscribes once another node listens to it. They are
    shown as declared, except for an external node, whose topics are unknown.
    """
    declared = {port.name: port for port in record.declared}
    seen = {}
    for port in ports:
        known = declared.get(port.name)
        if known is not None and not port.datatype:
            port = replace(port, direction=known.direction, datatype=known.datatype)
        seen[port.name] = replace(port, tags=known.tags if known is not None else ())
    if not (record.kind.is_written_for_dyknow or record.is_described):
        seen.update({each.name: each for each in declared_ports(record) if each.name not in seen})
    return tuple(seen.values())


def declared_ports(record: Record) -> Tuple[PortState, ...]:
    """Return the ports of a nodelet without a proxy, as its transformation and topics say."""
    topics = record.topics
    return tuple(
        PortState(each.name, each.direction, each.datatype, topics.get(each.name, ""), each.tags)
        for each in record.declared
    )


def awaited_ports(record: Record, ports: Iterable[PortState]) -> Tuple[str, ...]:
    """Return the declared ports that a nodelet has not made, by the ports that a proxy reports.

    For a port that was connected before the nodelet made it, the proxy reports the topic alone. A
    nodelet that was written for DyKnow makes its ports when it is loaded.
    """
    made = {port.name for port in ports if port.datatype or record.kind.is_written_for_dyknow}
    return tuple([port.name for port in record.declared if port.name not in made])


def with_present_ports(record: Record, ports: Tuple[PortState, ...]) -> Record:
    """Return a record with the ports of a proxy, whose topics are desired from now on."""
    seen, awaited = seen_ports(record, ports), awaited_ports(record, ports)
    moved = [port.name for port in seen if port.topic not in ("", record.topics.get(port.name))]
    record = replace(without_cut(record, moved), ports=seen, awaited=awaited)
    return replace(record, topics=topics_of(record))


def with_cut(record: Record, ports: Iterable[str]) -> Record:
    """Return a record that remembers where its user had ports that a claim moves.

    Those that claims connect as they need them are not among them.
    """
    if record.claimed:
        return record
    demanding = {port.name for port in record.ports if port.direction == IN and port.tags}
    moved = [port for port in ports if not (record.is_described and port in demanding)]
    cut = {**{port: record.topics.get(port, "") for port in moved}, **dict(record.cut)}
    return replace(record, cut=tuple(sorted(cut.items())))


def without_cut(record: Record, ports: Container[str]) -> Record:
    """Return a record of a nodelet whose ports are where its user has them."""
    return replace(record, cut=tuple([each for each in record.cut if each[0] not in ports]))


def missing_connections(record: Record, ports: Iterable[PortState]) -> Dict[str, str]:
    """Return the desired connections that the load did not make.

    It was loaded with the connections of those ports whose names its load remapped. The other
    topics of a C++ nodelet are where it puts them, unless they were moved.
    """
    if record.kind.is_written_for_dyknow:
        present = {port.name: port.topic for port in ports}
        return {
            port: topic
            for port, topic in record.topics.items()
            if topic and present.get(port) != topic
        }
    wanted = {**{port.name: "" for port in record.declared}, **record.topics}
    return {
        port.name: wanted[port.name]
        for port in ports
        if port.name in wanted and port.topic != wanted[port.name]
    }


def movable_ports(record: Record) -> Tuple[PortState, ...]:
    """Return the ports that are connected and disconnected as claims and wirings need it.

    Undeclared topics of a C++ nodelet (transforms, parameters, companions of an image) stay where
    it puts them until a user moves them.
    """
    if record.kind.is_written_for_dyknow or record.transformation is None:
        return moved_ports(record.ports, record.kind)
    declared = {port.name for port in record.declared}
    return tuple(port for port in record.ports if port.name in declared)


def topics_of(record: Record) -> Dict[str, str]:
    ports = moved_ports(record.ports, record.kind)
    return {port.name: port.topic for port in ports if port.topic}


def ports_on(record: Record, direction: str, topic: str) -> List[str]:
    return [
        each.name for each in record.ports if (each.direction, each.topic) == (direction, topic)
    ]
