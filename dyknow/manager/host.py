"""The seam between the manager and the nodelet managers.

The manager reaches nodelets only through a ``Host``. The real one speaks ROS
(``dyknow.ros.hosting.host``), the public fake beside this file keeps everything in memory.
"""

from __future__ import annotations

import enum
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

from dyknow.model.graph import PortState
from dyknow.model.transformation import Parameter


class NodeletKind(enum.Enum):
    """What a nodelet manager can host."""

    PYTHON = "python"
    CPP = "c++"


@dataclass(frozen=True)
class ManagerState:
    """A nodelet manager.

    Attributes:
        name: global node name.
        kind: what it can host.
        incarnation: differs after every restart of the process; empty when it is not there.
        isolated_for: the nodelet that it was started for alone, empty for shared ones.
        own: whether the host started it, and starts it again.
        responsive: whether it answered when it was asked last.
        away: whether its host does not answer, so that nobody knows if it is there.
        unseen: whether it was not looked for yet; what was known of it before holds till then.
    """

    name: str
    kind: NodeletKind = NodeletKind.PYTHON
    incarnation: str = ""
    isolated_for: str = ""
    own: bool = True
    responsive: bool = True
    away: bool = False
    unseen: bool = False

    @property
    def alive(self) -> bool:
        """Whether its process is there."""
        return bool(self.incarnation)


@dataclass(frozen=True)
class Crash:
    """A nodelet manager's process that ended by a fault of its own: a native crash, ``_exit``.

    One that was told to end, or killed by others, is none.

    Attributes:
        manager: its name.
        cause: signal or exit code, in words.
        running: marks (``names.mark``) of the nodelets whose code was running; None if nobody can
            tell, as of the stock nodelet manager.
        unloading: marks of those whose unload somebody had asked for.
    """

    manager: str
    cause: str
    running: Optional[FrozenSet[int]] = None
    unloading: FrozenSet[int] = frozenset()


@dataclass(frozen=True)
class LoadRequest:
    """What is needed to load a nodelet.

    Attributes:
        name: global name.
        source: declared type, ``package/Class``.
        parameters: set in the nodelet's namespace before the load.
        remappings: global names, source to target.
    """

    name: str
    source: str
    parameters: Tuple[Parameter, ...] = ()
    remappings: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Count:
    """How many messages had gone through a port, or come on a topic, at a moment between two.

    Attributes:
        messages: since the port, or the listening, began.
        asked: they were counted no earlier than this, in seconds of a steady clock.
        answered: nor later than this.
        latched: whether the port keeps a message for whoever connects later.
    """

    messages: int
    asked: float
    answered: float
    latched: bool = False


class Listening(ABC):
    """Counts the messages of one topic until it is closed."""

    @abstractmethod
    def count(self) -> Optional[Count]:
        """Messages since the listening began; None as long as it has not begun."""

    @abstractmethod
    def close(self) -> None:
        """Listen no more; returns at once."""


class Host(ABC):
    """Runs nodelets. Every call has its own time limit and raises ``HostError`` beyond it."""

    @abstractmethod
    def kind_of(self, source: str) -> NodeletKind:
        """Tell what kind of nodelet a declared type is.

        Raises:
            HostError: no package declares it.
        """

    @abstractmethod
    def managers(self) -> List[ManagerState]:
        """List the nodelet managers that nodelets can be given to, dead ones included."""

    def crashes(self) -> List[Crash]:
        """Crashes since the last call, as far as they are seen.

        A nodelet manager that ``managers`` shows as dead, or anew, after a crash is told of by
        the next call.
        """
        return []

    @abstractmethod
    def look_for(self, manager: str) -> None:
        """Look at once whether a nodelet manager of others is there by now.

        Those that do not answer are not waited for.
        """

    @abstractmethod
    def ensure(self, kind: NodeletKind, isolated_for: str = "") -> str:
        """Return the name of a nodelet manager of that kind that is up, starting it if need be.

        Args:
            kind: what it must be able to host.
            isolated_for: the nodelet that is to have it alone; empty for a shared one.
        """

    @abstractmethod
    def retire(self, manager: str) -> None:
        """End an isolated nodelet manager, whatever it is doing."""

    @abstractmethod
    def load(self, manager: str, request: LoadRequest, timeout: float) -> None:
        """Set the parameters and load the nodelet."""

    @abstractmethod
    def unload(self, manager: str, name: str) -> None:
        """Unload a nodelet, also one that is still being loaded.

        If its process dies of that, ``managers`` shows so by the time that this raises.
        """

    @abstractmethod
    def forget(self, name: str, parameters: Sequence[Parameter]) -> None:
        """Delete the parameters that ``load`` set; those set by others stay."""

    @abstractmethod
    def list(self, manager: str) -> List[str]:
        """Names of the nodelets that a nodelet manager runs."""

    @abstractmethod
    def lists(self, managers: Iterable[ManagerState]) -> Dict[str, List[str]]:
        """Names of the nodelets of several nodelet managers, asked side by side.

        One that does not answer, or is another process by now, is left out.
        """

    @abstractmethod
    def ports(self, name: str) -> Tuple[PortState, ...]:
        """Ports of a nodelet that has a proxy.

        Raises:
            HostError: the proxy does not answer.
        """

    @abstractmethod
    def connect(self, name: str, config: Mapping[str, str]) -> None:
        """Connect ports of a nodelet that has a proxy, all or none.

        Raises:
            HostError: the proxy refused or does not answer; its words are in the text.
        """

    @abstractmethod
    def published(self, topics: Iterable[str]) -> FrozenSet[str]:
        """Tell which of these ordinary topics have a publisher now.

        Raises:
            HostError: nobody can tell, since the ROS master does not answer.
        """

    @abstractmethod
    def counts(
        self, wanted: Mapping[str, Collection[str]]
    ) -> Dict[str, Optional[Mapping[str, Count]]]:
        """Ask nodelet managers, side by side, how many messages nodelets have sent.

        An absent or hung nodelet manager delays this by half a second, once; as long as its answer
        is due it is not waited for.

        Args:
            wanted: names of nodelets, by nodelet manager.

        Returns:
            For each nodelet the counts of its out-ports; None for one that is not there. Those
            that are not known yet are left out; when they are, the next call returns them.
        """

    @abstractmethod
    def listen(self, topic: str) -> Listening:
        """Begin to listen to a topic whose publishers cannot be asked; returns at once."""
