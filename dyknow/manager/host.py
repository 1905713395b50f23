# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The seam between the manager and the nodelet managers.

The manager reaches nodelets only through a ``Host``. The real one speaks ROS
(``dyknow.ros.hosting.host``), the public fake (``fake_host``) keeps everything in memory.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import (
    Collection,
    Dict,
    FrozenSet,
    Iterable,
    List,
    Mapping,
    Optional,
    Sequence,
    Tuple,
)

from dyknow.model.graph import NodeletKind, PortState
from dyknow.model.transformation import Parameter, Transformation


@dataclass(frozen=True)
class ManagerState:
    """A nodelet manager, or a node that is re-wirable in a process of its own.

    Such a node is shown as if it hosted itself, and can host nothing else. Those that the host
    started are its own.

    Attributes:
        name: global node name.
        kind: what it can host.
        incarnation: differs after every restart of the process; empty when it is not there.
        isolated_for: the nodelet that it was started for alone, empty for shared ones.
        own: whether the host started it, and starts it again.
        responsive: whether it answered when it was asked last.
        away: whether its host does not answer, so that it is not known whether it is there.
        unseen: whether it was not looked for yet; until then holds what was known of it before.
        rewirable: whether its nodelets have live ports; those of a stock C++ one do not.
        host: machine that its process is on, as ROS names it; empty if that is not known.
        cure: what a user can do if it does not answer, for people.
    """

    name: str
    kind: NodeletKind = NodeletKind.PYTHON
    incarnation: str = ""
    isolated_for: str = ""
    own: bool = True
    responsive: bool = True
    away: bool = False
    unseen: bool = False
    rewirable: bool = True
    host: str = ""
    cure: str = ""

    @property
    def alive(self) -> bool:
        """Whether its process is there."""
        return bool(self.incarnation)


@dataclass(frozen=True)
class Crash:
    """A nodelet manager's process that ended by a fault of its own: a native crash, ``_exit``.

    A process that was told to end, or was killed by others, did not crash.

    Attributes:
        manager: its name.
        cause: signal or exit code, in words.
        running: marks (``names.mark``) of the nodelets whose code was running; None if that is not
            known, as of the stock nodelet manager.
        unloading: marks of the nodelets that were being unloaded on request.
        incarnation: the process that crashed.
    """

    manager: str
    cause: str
    running: Optional[FrozenSet[int]] = None
    unloading: FrozenSet[int] = frozenset()
    incarnation: str = ""


@dataclass(frozen=True)
class HostReport:
    """What a host saw when it was polled.

    Attributes:
        managers: nodelet managers and re-wirable nodes by name, dead ones included.
        nodelets: what each of them runs; without those that did not answer, or were restarted
            meanwhile.
        crashes: recent ones by incarnation. The crash of a process that ``managers`` shows as
            dead, or as restarted, is among them.
    """

    managers: Mapping[str, ManagerState]
    nodelets: Mapping[str, FrozenSet[str]]
    crashes: Mapping[str, Crash]


@dataclass(frozen=True)
class LoadRequest:
    """What is needed to load a nodelet, or to start a node.

    Attributes:
        name: global name.
        source: declared type, ``package/Class``, or the program of a script or node.
        parameters: set in the nodelet's namespace before the load.
        remappings: global names, source to target.
        kind: what it is.
    """

    name: str
    source: str
    parameters: Tuple[Parameter, ...] = ()
    remappings: Mapping[str, str] = field(default_factory=dict)
    kind: NodeletKind = NodeletKind.PYTHON


@dataclass(frozen=True)
class Count:
    """Messages that had gone through a port, or come on a topic, between two moments.

    Attributes:
        messages: how many, since the port was made or the listening began.
        asked: they were counted no earlier than this, in seconds of a steady clock.
        answered: nor later than this.
        latched: whether the port keeps a message for subscribers that connect later.
        age: how old one of the messages since the last count was when it was sent, in seconds by
            its stamp; of no meaning if there was none. None where that is not known.
    """

    messages: int
    asked: float
    answered: float
    latched: bool = False
    age: Optional[float] = None


class Listening(ABC):
    """Counts the messages of one topic until it is closed."""

    @abstractmethod
    def count(self) -> Optional[Count]:
        """Return the messages since the listening began; None until it has."""

    @abstractmethod
    def close(self) -> None:
        """End the listening; does not wait."""


class Host(ABC):
    """Runs nodelets. Every call has its own time limit and raises ``HostError`` beyond it."""

    @abstractmethod
    def kind_of(self, transformation: Transformation) -> NodeletKind:
        """Return the kind of what is made of a transformation.

        Raises:
            HostError: no package declares the nodelet type, or has a program that can be used.
        """

    @abstractmethod
    def managers(self) -> List[ManagerState]:
        """List the nodelet managers that nodelets can be given to, dead ones included."""

    @abstractmethod
    def poll(self) -> HostReport:
        """Ask all nodelet managers for their nodelets, side by side."""

    def may_publish(self, manager: str) -> bool:
        """Whether a nodelet manager that does not answer may still publish on topics of claims.

        Until it certainly does not, nothing of it is replaced.
        """
        return False

    @abstractmethod
    def look_for(self, manager: str) -> None:
        """Probe an external nodelet manager now instead of at its next poll.

        One that does not answer is not awaited.
        """

    @abstractmethod
    def ensure(self, kind: NodeletKind, isolated_for: str = "") -> str:
        """Return the name of a nodelet manager of that kind that is up, starting it if need be.

        A node hosts itself, under its own name, and is not up before it is loaded.

        Args:
            kind: what it must be able to host.
            isolated_for: the nodelet that is to have it alone; empty for a shared one.
        """

    @abstractmethod
    def retire(self, manager: str) -> None:
        """End an isolated nodelet manager, whatever it is doing."""

    @abstractmethod
    def load(self, manager: str, request: LoadRequest, timeout: float) -> None:
        """Set the parameters and load the nodelet, or start the node."""

    @abstractmethod
    def unload(self, manager: str, name: str) -> None:
        """Unload a nodelet, also one that is still being loaded, or end a node.

        If its process dies of that, ``managers`` shows it by the time that this raises.
        """

    @abstractmethod
    def forget(self, name: str, parameters: Sequence[str]) -> None:
        """Delete the parameters of these names that ``load`` set; others' parameters stay."""

    @abstractmethod
    def list(self, manager: str) -> List[str]:
        """Return the names of the nodelets that a nodelet manager runs."""

    @abstractmethod
    def ports(self, name: str) -> Tuple[PortState, ...]:
        """Return the ports of a nodelet that has a proxy.

        Raises:
            HostError: the proxy does not answer.
        """

    def detail(self, name: str) -> str:
        """Return what ails a nodelet, as its nodelet manager says; empty if nothing does."""
        return ""

    @abstractmethod
    def connect(self, name: str, config: Mapping[str, str]) -> None:
        """Connect ports of a nodelet that has a proxy, all or none.

        Raises:
            HostError: the proxy refused, for a reason that is in the text, or does not answer.
        """

    @abstractmethod
    def published(self, topics: Iterable[str]) -> FrozenSet[str]:
        """Return those of these ordinary topics that have a publisher now.

        Raises:
            HostError: the ROS master does not answer.
        """

    @abstractmethod
    def counts(
        self, wanted: Mapping[str, Collection[str]]
    ) -> Dict[str, Optional[Mapping[str, Count]]]:
        """Ask nodelet managers, side by side, how many messages nodelets have sent.

        A nodelet manager that does not answer delays this by half a second, once: as long as its
        answer is due, it is not awaited again.

        Args:
            wanted: names of nodelets, by nodelet manager.

        Returns:
            For each nodelet the counts of its out-ports; None for a nodelet that is not there.
            Nodelets without an answer yet are left out until a later call.
        """

    @abstractmethod
    def is_stamped(self, datatype: str) -> Optional[bool]:
        """Whether messages of a type bear a time stamp: begin with a header; None if not known."""

    @abstractmethod
    def listen(self, topic: str) -> Listening:
        """Begin to listen to a topic whose publishers cannot be asked; does not wait."""
