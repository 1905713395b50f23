"""What the manager and the proxies answer, as values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Optional, Tuple

from dyknow_msgs.msg import Model as ModelMessage
from dyknow_msgs.msg import Nodelet as NodeletMessage
from dyknow_msgs.msg import Port as PortMessage
from dyknow_msgs.msg import PortStatistics
from dyknow_msgs.msg import Transformation as TransformationMessage

from dyknow.model.graph import PortState, State
from dyknow.model.transformation import IN, OUT, Parameter, Port, Transformation


@dataclass(frozen=True)
class NodeletView:
    """A nodelet as the manager shows it; the fields are those of ``dyknow_msgs/Nodelet``."""

    name: str
    transformation: str
    manager: str
    is_protected: bool
    isolated: bool
    rewired_by_reload: bool
    state: State
    detail: str
    ports: Tuple[PortState, ...]

    def port(self, name: str) -> Optional[PortState]:
        """Return the port of that name, or None."""
        return next((port for port in self.ports if port.name == name), None)


@dataclass(frozen=True)
class ModelView:
    """The model as the manager shows it.

    Attributes:
        revision: grows with every change of the nodelets.
        library_revision: grows with every change of the transformations.
        nodelets: by name.
        transformations: by label; empty on the topic.
    """

    revision: int
    library_revision: int
    nodelets: Tuple[NodeletView, ...]
    transformations: Tuple[Transformation, ...]

    def nodelet(self, name: str) -> Optional[NodeletView]:
        """Return the nodelet of that global name, or None."""
        return next((each for each in self.nodelets if each.name == name), None)


@dataclass(frozen=True)
class PortTraffic:
    """What went through a port; times in seconds, the rate in Hz; None where nobody counts."""

    port: str
    direction: str
    topic: str
    messages: Optional[int]
    dropped: Optional[int]
    rate: Optional[float]
    mean_callback: Optional[float]
    max_callback: Optional[float]


@dataclass(frozen=True)
class Statistics:
    """What a nodelet did since it was loaded; the time in seconds; None where nobody counts."""

    uptime: float
    reconfigurations: int
    callback_errors: Optional[int]
    ports: Tuple[PortTraffic, ...]


def model_view(message: ModelMessage) -> ModelView:
    """Read a model, as ``get_model`` answers or the topic ``~model`` carries it."""
    return ModelView(
        message.revision,
        message.library_revision,
        tuple(_nodelet_view(each) for each in message.nodelets),
        tuple(_transformation(each) for each in message.transformations),
    )


def port_view(message: PortMessage) -> PortState:
    """Read a port."""
    return PortState(
        message.name, _direction(message), message.datatype, message.topic, tuple(message.tags)
    )


def statistics_view(answer: Any) -> Statistics:
    """Read the answer of ``get_statistics``."""
    return Statistics(
        answer.uptime.to_sec(),
        answer.reconfigurations,
        None if any(map(_is_unknown, answer.ports)) else answer.callback_errors,
        tuple(map(_port_traffic, answer.ports)),
    )


def _is_unknown(message: PortStatistics) -> bool:
    """Whether nobody counts what goes through the port."""
    return math.isnan(message.rate)


def _port_traffic(message: PortStatistics) -> PortTraffic:
    port = (message.port, _direction(message), message.topic)
    if _is_unknown(message):
        return PortTraffic(*port, None, None, None, None, None)
    return PortTraffic(
        *port,
        message.messages,
        message.dropped,
        message.rate,
        message.mean_callback.to_sec(),
        message.max_callback.to_sec(),
    )


def _nodelet_view(message: NodeletMessage) -> NodeletView:
    return NodeletView(
        message.name,
        message.transformation,
        message.manager,
        message.is_protected,
        message.isolated,
        message.rewired_by_reload,
        State(message.state),
        message.detail,
        tuple(port_view(port) for port in message.ports),
    )


def _transformation(message: TransformationMessage) -> Transformation:
    return Transformation(
        message.label,
        message.source,
        message.type,
        message.cost,
        tuple(Parameter(each.name, each.type, each.value) for each in message.parameters),
        tuple(
            Port(each.name, _direction(each), each.datatype, tuple(each.tags))
            for each in message.ports
        ),
    )


def _direction(message: Any) -> str:
    return OUT if message.direction == PortMessage.OUT else IN
