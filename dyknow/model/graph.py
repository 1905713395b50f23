# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The computation graph, as values: the paper's GetModel."""

from __future__ import annotations

import enum
import re
from dataclasses import dataclass, field
from typing import Dict, Mapping, Optional, Tuple

from dyknow.model.hosts import AT
from dyknow.model.transformation import Parameter, Transformation
from dyknow.names import FORMS, below


class State(enum.IntEnum):
    """State of a nodelet; the numbers are those of ``dyknow_msgs/Nodelet``."""

    STARTING = 0
    RUNNING = 1
    LOST = 2
    FAILED = 3


class NodeletKind(enum.Enum):
    """Kind of an object with ports; the values are those of ``dyknow_msgs/Nodelet``."""

    PYTHON = "nodelet"
    CPP = "cpp_nodelet"
    SCRIPT = "script"
    NODE = "node"
    CPP_NODE = "cpp_node"

    @property
    def is_written_for_dyknow(self) -> bool:
        """Whether its ports are declared as such; else they are the topics that it uses."""
        return self is NodeletKind.PYTHON

    @property
    def is_node(self) -> bool:
        """Whether it is a process of its own, without a nodelet manager: it hosts itself."""
        return self in (NodeletKind.NODE, NodeletKind.CPP_NODE)

    @property
    def host(self) -> NodeletKind:
        """The kind of the nodelet managers that host it: scripts run beside Python nodelets."""
        return NodeletKind.PYTHON if self is NodeletKind.SCRIPT else self

    @property
    def alone(self) -> NodeletKind:
        """The kind of the same in a process of its own: a script runs as the node that it is."""
        return NodeletKind.NODE if self is NodeletKind.SCRIPT else self

    @property
    def title(self) -> str:
        """Display name."""
        return _TITLES[self]


_TITLES = {
    NodeletKind.PYTHON: "Python nodelet",
    NodeletKind.CPP: "C++ nodelet",
    NodeletKind.SCRIPT: "Python script",
    NodeletKind.NODE: "Python node",
    NodeletKind.CPP_NODE: "C++ node",
}


#: How the detail of a nodelet begins that has a callback which does not return.
STUCK = "a callback has been running for "
#: How the part of a nodelet's detail begins that says why a restart would make it differently.
OUTDATED = "outdated: "
_OUTDATED = re.compile(rf"(?:\A|; ){OUTDATED}(its .*)\Z", re.DOTALL)
#: How the part of ``dyknow_msgs/Nodelet.detail`` begins that names the owner of one that was not
#: spawned.
OWNER = "owner: "


@dataclass(frozen=True)
class PortState:
    """A port of a running nodelet."""

    name: str  #: unique in the nodelet
    direction: str  #: ``in`` or ``out``
    datatype: str = ""  #: ROS type, empty when not known yet
    topic: str = ""  #: global name, empty when disconnected
    tags: Tuple[str, ...] = ()  #: those of the transformation


def moved_ports(ports: Tuple[PortState, ...], kind: NodeletKind) -> Tuple[PortState, ...]:
    """Return the ports without the companions of images that move with their ports.

    Whether there is such a companion is up to a parameter of the nodelet. Nodelets in C++ make
    theirs where they put their images.
    """
    if not kind.is_written_for_dyknow:
        return ports
    topics = {port.name: port.topic for port in ports}

    def follows(port: PortState) -> bool:
        main, _, form = port.name.rpartition("/")
        return form in FORMS and main in topics and port.topic == below(topics[main], form)

    return tuple(port for port in ports if not follows(port))


@dataclass(frozen=True)
class PortRef:
    """A port, named from outside its nodelet; written ``NODELET:PORT``."""

    nodelet: str
    port: str

    def __str__(self) -> str:
        """Write ``NODELET:PORT``."""
        return f"{self.nodelet}:{self.port}"


@dataclass(frozen=True)
class NodeletStatus:
    """A nodelet and how it is connected; the fields are those of ``dyknow_msgs/Nodelet``."""

    name: str  #: global name
    #: Label of the transformation that it was made from; empty if another client loaded it.
    transformation: str
    manager: str  #: nodelet manager that hosts it; empty for a node in a process of its own
    is_protected: bool  #: whether ``destroy`` refuses it
    isolated: bool  #: whether it has a process of its own
    #: Whether its topics are fixed since its start: a C++ nodelet in a nodelet manager without
    #: live ports.
    is_fixed: bool
    state: State  #: whether it runs
    detail: str  #: why it does not, or is outdated, in words
    ports: Tuple[PortState, ...]  #: in the order in which the nodelet made them
    #: Those that were given to it when it was spawned, by name.
    parameters: Tuple[Parameter, ...] = ()
    kind: NodeletKind = NodeletKind.PYTHON  #: Python or C++, nodelet, script or node
    host: str = ""  #: machine that it runs on, as ROS names it; empty if unknown
    #: The node that had it loaded (another DyKnow manager, ``nodelet load``) or, of a node, the
    #: DyKnow manager that started it; else its process. Empty if it was spawned.
    owner: str = ""

    @property
    def node(self) -> str:
        """Global name of the node that it is, or is in."""
        return self.manager or self.name

    @property
    def origin(self) -> str:
        """Its transformation or, for people, its owner."""
        return self.transformation or f"(by {self.owner})"

    @property
    def outdated(self) -> str:
        """Why a restart would make it differently, in words; empty if it would not."""
        found = _OUTDATED.search(self.detail)
        return found[1] if found else ""

    @property
    def connections(self) -> Dict[str, str]:
        """Topics of the ports that are connected, by port, sorted; without companions."""
        ports = sorted(moved_ports(self.ports, self.kind), key=lambda port: port.name)
        return {port.name: port.topic for port in ports if port.topic}

    @property
    def request(self) -> SpawnRequest:
        """The request that makes it again; an isolated one gets another process of its own."""
        return SpawnRequest(
            self.transformation,
            self.name,
            self.connections,
            self.is_protected,
            self.isolated,
            "" if self.isolated else self.manager,
            self.parameters,
        )

    def port(self, name: str) -> Optional[PortState]:
        """Return the port of that name, or None."""
        return next((port for port in self.ports if port.name == name), None)


@dataclass(frozen=True)
class Model:
    """The computation graph at one moment."""

    revision: int  #: grows with every change of the nodelets, over restarts too
    library_revision: int  #: grows with every change of the transformations
    nodelets: Tuple[NodeletStatus, ...]  #: by name
    #: By label; empty where only the graph was requested.
    transformations: Tuple[Transformation, ...] = ()

    def nodelet(self, name: str) -> Optional[NodeletStatus]:
        """Return the nodelet of that global name, or None."""
        return next((each for each in self.nodelets if each.name == name), None)


@dataclass(frozen=True)
class Restarted:
    """Names of the nodelets that were restarted, and remarks for people, one a line."""

    names: Tuple[str, ...]
    remarks: str = ""


@dataclass(frozen=True)
class ParameterSet:
    """The outcome of setting a parameter."""

    is_read: bool  #: whether the nodelet has read it already; else a restart lets it
    remarks: str = ""  #: for people, one a line


@dataclass(frozen=True)
class SpawnRequest:
    """A request for a new nodelet."""

    label: str  #: of the transformation
    name: str  #: of the new nodelet
    #: Topics by port; ports that are not named start disconnected.
    config: Mapping[str, str] = field(default_factory=dict)
    is_protected: bool = False  #: refuse to destroy it
    isolated: bool = False  #: give it a process of its own
    #: Nodelet manager to use, or ``@HOST`` for one on that host, always; empty for the manager's
    #: choice.
    manager: str = ""
    #: Names override the transformation's parameters, variables such as ``?camera`` carry their
    #: names; an empty type is the transformation's, or follows from the text.
    parameters: Tuple[Parameter, ...] = ()

    @property
    def host(self) -> str:
        """The host that it names; empty if it names none."""
        return self.manager[1:] if self.manager[:1] == AT else ""
