"""The manager's model as plain values: what `dyknow_msgs/Model` says, for those who only look."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping, Optional, Tuple

from dyknow.manager.model import PortState, State
from dyknow.manager.transformation import IN, OUT, Parameter, Port, Transformation

_DIRECTIONS = (IN, OUT)  # in the order of the message's constants


@dataclass(frozen=True)
class Nodelet:
    """A nodelet that the manager knows of.

    Attributes:
        name: global name.
        label: the transformation that it was made from; empty for one that others loaded.
        manager: nodelet manager that hosts it.
        is_protected: whether destroying it is refused.
        isolated: whether it has a process of its own.
        rewired_by_reload: a plain C++ nodelet: connecting it elsewhere loads it anew.
        state: `starting`, `running`, `lost` or `failed`.
        detail: the cause of the state, in words.
        ports: its ports with their types, topics and tags.
    """

    name: str
    label: str = ""
    manager: str = ""
    is_protected: bool = False
    isolated: bool = False
    rewired_by_reload: bool = False
    state: str = "running"
    detail: str = ""
    ports: Tuple[PortState, ...] = ()

    def port(self, name: str) -> Optional[PortState]:
        """Return the port of that name, or None."""
        return next((port for port in self.ports if port.name == name), None)

    @property
    def connections(self) -> Mapping[str, str]:
        """Topics of the ports that are connected."""
        return {port.name: port.topic for port in self.ports if port.topic}


@dataclass(frozen=True)
class Snapshot:
    """The computation graph at one moment.

    Attributes:
        revision: grows with every change of the nodelets.
        library_revision: grows with every change of the transformations.
        nodelets: by name.
        transformations: by label; empty where only the nodelets were asked for.
    """

    revision: int = 0
    library_revision: int = 0
    nodelets: Tuple[Nodelet, ...] = ()
    transformations: Tuple[Transformation, ...] = ()

    def nodelet(self, name: str) -> Optional[Nodelet]:
        """Return the nodelet of that global name, or None."""
        return next((nodelet for nodelet in self.nodelets if nodelet.name == name), None)

    def transformation(self, label: str) -> Optional[Transformation]:
        """Return the transformation of that label, or None."""
        return next((each for each in self.transformations if each.label == label), None)


@dataclass(frozen=True)
class PortStatistics:
    """What went through a port since its nodelet was loaded.

    Attributes:
        port: name of the port.
        direction: `in` or `out`.
        topic: global name, empty when disconnected.
        messages: received by an in-port, sent by an out-port.
        dropped: lost to a full queue, or published while disconnected.
        rate: recent messages a second.
        mean_callback: mean time (s) of a callback of an in-port.
        max_callback: longest time (s) of a callback of an in-port.
    """

    port: str
    direction: str
    topic: str
    messages: int
    dropped: int
    rate: float
    mean_callback: float
    max_callback: float


@dataclass(frozen=True)
class Statistics:
    """What a nodelet has done since it was loaded.

    Attributes:
        uptime: seconds since then.
        reconfigurations: how often its connections were changed.
        callback_errors: exceptions that left its callbacks.
        ports: what went through each port.
    """

    uptime: float
    reconfigurations: int
    callback_errors: int
    ports: Tuple[PortStatistics, ...]


def read_model(message: Any) -> Snapshot:
    """Read a `dyknow_msgs/Model`."""
    return Snapshot(
        message.revision,
        message.library_revision,
        tuple(_read_nodelet(each) for each in message.nodelets),
        tuple(_read_transformation(each) for each in message.transformations),
    )


def read_ports(messages: Any) -> Tuple[PortState, ...]:
    """Read `dyknow_msgs/Port[]`, those of a running nodelet."""
    return tuple(
        PortState(
            each.name,
            _DIRECTIONS[each.direction],
            each.datatype,
            each.topic,
            tuple(each.tags),
        )
        for each in messages
    )


def read_statistics(response: Any) -> Statistics:
    """Read the answer of `dyknow_msgs/GetStatistics`."""
    return Statistics(
        response.uptime.to_sec(),
        response.reconfigurations,
        response.callback_errors,
        tuple(
            PortStatistics(
                each.port,
                _DIRECTIONS[each.direction],
                each.topic,
                each.messages,
                each.dropped,
                each.rate,
                each.mean_callback.to_sec(),
                each.max_callback.to_sec(),
            )
            for each in response.ports
        ),
    )


def _read_nodelet(message: Any) -> Nodelet:
    return Nodelet(
        message.name,
        message.transformation,
        message.manager,
        message.is_protected,
        message.isolated,
        message.rewired_by_reload,
        State(message.state).name.lower(),
        message.detail,
        read_ports(message.ports),
    )


def _read_transformation(message: Any) -> Transformation:
    return Transformation(
        message.label,
        message.source,
        message.type,
        message.cost,
        tuple(Parameter(each.name, each.type, each.value) for each in message.parameters),
        tuple(
            Port(each.name, _DIRECTIONS[each.direction], each.datatype, tuple(each.tags))
            for each in message.ports
        ),
    )
