"""What the manager and the proxies answer, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Optional, Tuple

from dyknow_msgs.msg import Model as ModelMessage
from dyknow_msgs.msg import Nodelet as NodeletMessage
from dyknow_msgs.msg import Port as PortMessage
from dyknow_msgs.msg import Transformation as TransformationMessage

from dyknow.manager.model import PortState, State
from dyknow.manager.specifications.transformation import IN, OUT, Parameter, Port, Transformation


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
    """What went through a port; times in seconds, the rate in Hz."""

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
    """What a nodelet did since it was loaded; the time in seconds."""

    uptime: float
    reconfigurations: int
    callback_errors: int
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
        answer.callback_errors,
        tuple(
            PortTraffic(
                each.port,
                _direction(each),
                each.topic,
                each.messages,
                each.dropped,
                each.rate,
                each.mean_callback.to_sec(),
                each.max_callback.to_sec(),
            )
            for each in answer.ports
        ),
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
