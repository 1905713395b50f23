# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The seam between the manager and the processes that run nodelets.

The manager reaches nodelets only through a ``Host``. The real one speaks ROS
(``dyknow.ros.hosting.host``), the public fake (``dyknow.simulated.host``) is in memory.
"""

from __future__ import annotations

import builtins
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Callable, Collection, ContextManager, Iterable, Mapping, Sequence

from dyknow.model.graph import NodeletKind, PortState
from dyknow.model.hosts import UNKNOWN_MACHINE, UNKNOWN_OFFSET, ClockOffset, Machine
from dyknow.model.transformation import Parameter, Transformation


@dataclass(frozen=True)
class ProcessState:
    """A nodelet manager, or a re-wirable node in its own process, which hosts itself alone."""

    name: str  # global node name
    kind: NodeletKind = NodeletKind.PYTHON  # the kind of nodelets that it can host
    #: Differs after every restart of the process; empty when it is not running.
    incarnation: str = ""
    isolated_for: str = ""  # the only nodelet that it may host, empty for shared ones
    own: bool = True  # whether the host started it, and starts it again
    responsive: bool = True  # whether it answered the last request
    away: bool = False  # whether its machine does not answer, so that it may be running or not
    #: Whether the first probe is not over; until then the earlier records hold.
    unseen: bool = False
    rewirable: bool = True  # whether its nodelets have live ports; those of a stock C++ one do not
    host: str = ""  # its machine, as ROS names it; empty if unknown
    machine: Machine = UNKNOWN_MACHINE  # the load of the machine, as it said last
    clock: ClockOffset = UNKNOWN_OFFSET  # how the clock of the machine differs from ours
    cure: str = ""  # advice for users if it does not answer
    #: Whether another client started it, and this manager is not to use it: nothing is loaded or
    #: unloaded there.
    foreign: bool = False

    @property
    def alive(self) -> bool:
        return bool(self.incarnation)


@dataclass(frozen=True)
class Crash:
    """A process that ended by a fault of its own: a native crash, ``_exit``.

    A process that ended on request, or was killed, did not crash.
    """

    manager: str  # its name
    cause: str  # signal or exit code, for people
    #: Marks (``names.mark``) of the nodelets whose code was running; None if unknown, as in the
    #: stock nodelet manager.
    running: frozenset[int] | None = None
    #: Marks of the nodelets that were being unloaded on request.
    unloading: frozenset[int] = frozenset()
    incarnation: str = ""  # the process that crashed


@dataclass(frozen=True)
class Reported:
    """A process's report of a nodelet with live ports."""

    ports: tuple[PortState, ...] = ()  # in the order of their declaration, without tags
    detail: str = ""  # its problem; empty for none
    sequence: int = 0  # number of the last change of its process that this contains
    #: Node that had it loaded or, of a node, DyKnow manager that started it; empty if unknown.
    loader: str = ""


@dataclass(frozen=True)
class HostReport:
    """The outcome of polling a host."""

    #: Nodelet managers and re-wirable nodes by name, dead ones included.
    processes: Mapping[str, ProcessState]
    #: Names of the nodelets of each; without processes that did not answer, or were restarted
    #: meanwhile.
    nodelets: Mapping[str, frozenset[str]]
    #: Recent ones by incarnation, complete for processes that ``processes`` shows as dead or
    #: restarted.
    crashes: Mapping[str, Crash]


@dataclass(frozen=True)
class LoadRequest:
    """A nodelet to load, or a node to start."""

    name: str  # global name
    source: str  # declared type, ``package/Class``, or the program of a script or node
    parameters: tuple[Parameter, ...] = ()  # set in the nodelet's namespace before the load
    remappings: Mapping[str, str] = field(default_factory=dict)  # global names, source to target
    kind: NodeletKind = NodeletKind.PYTHON  # kind of nodelet or node


@dataclass(frozen=True)
class Count:
    """A count of messages that holds for some moment in an interval of steady time."""

    messages: int  # their number since the port was made or the subscription began
    asked: float  # beginning of the interval (s)
    answered: float  # end of the interval (s)
    latched: bool = False  # whether the port keeps a message for later subscribers
    #: How old one of the messages since the last count was when it was sent (s, by its stamp);
    #: arbitrary if there was none, None if unknown.
    age: float | None = None


@dataclass(frozen=True)
class HeardVerdict:
    """The last verdict on a topic that is TRUE or FALSE."""

    is_true: bool  # whether the formula holds
    heard: float  # when the first of the equal verdicts came, in steady time (s)
    stamp: float  # the time of their first state (s, ROS time)
    why: str = ""  # the values that decided there
    was_false: bool = False  # whether any verdict on the topic was FALSE
    state: float = -math.inf  # when the last of their states was, in steady time (s)

    def after(self, known: HeardVerdict | None) -> HeardVerdict:
        """Return the last verdict after the known one: that goes on if they are equal."""
        if known is not None and known.is_true is self.is_true:
            return replace(known, state=self.state)
        was_false = not self.is_true or (known is not None and known.was_false)
        return replace(self, was_false=was_false)


@dataclass(frozen=True)
class Usage:
    """The time that a process has used until some moment."""

    moment: float  # by its own steady clock (s)
    cpu: float  # seconds of processor time
    busy: Mapping[str, float]  # seconds in callbacks, by nodelet


class Listening(ABC):
    """Counts the messages of one topic until it is closed."""

    @abstractmethod
    def count(self) -> Count | None:
        """Return the messages since the listening began; None until it has."""

    @abstractmethod
    def close(self) -> None:
        pass


class Host(ABC):
    """Runs nodelets. Every call has its own time limit and raises ``HostError`` beyond it."""

    @abstractmethod
    def kind_of(self, transformation: Transformation) -> NodeletKind:
        """Return the kind that a transformation makes; HostError if its source is unknown."""

    @abstractmethod
    def states(self) -> Mapping[str, ProcessState]:
        """Return the processes by name, sorted, dead ones included; none of them is queried."""

    @abstractmethod
    def poll(self) -> HostReport:
        """Ask all nodelet managers for their nodelets, side by side."""

    @property
    @abstractmethod
    def here(self) -> str:
        """The machine that this process runs on, as ROS names it."""

    def address_of(self, name: str) -> str:
        """Return the IP address of a machine; empty if it is not known yet."""
        return ""

    @abstractmethod
    def publishing_hosts(self, topics: Iterable[str]) -> frozenset[str]:
        """Return the machines of the nodes that publish on any of these topics now."""

    def may_publish(self, manager: str) -> bool:
        """Whether a process that does not answer may still publish on topics of claims.

        Its nodelets are not replaced before it has certainly stopped.
        """
        return False

    @abstractmethod
    def look_for(self, manager: str) -> None:
        """Probe an external nodelet manager now; one that does not answer is not awaited."""

    @abstractmethod
    def ensure(self, kind: NodeletKind, isolated_for: str = "") -> str:
        """Return the name of a nodelet manager that is up for a kind, starting it if need be.

        A node hosts itself, under its own name, and is not up before it is loaded.
        """

    @abstractmethod
    def retire(self, manager: str) -> None:
        """End an isolated nodelet manager, by force if need be."""

    @abstractmethod
    def renew(self, manager: str) -> None:
        """End a shared nodelet manager of ours, and return when its successor is up."""

    @abstractmethod
    def code_of(self, manager: str, transformation: Transformation, anew: bool = False) -> str:
        """Return a text that differs when the files of a nodelet's code do, for a load there.

        It is empty if they are not known; with ``anew`` they are looked for first, else it may be
        half a second old.
        """

    @abstractmethod
    def check_code(self, transformation: Transformation) -> None:
        """Raise HostError if a file that has changed since the last load cannot be run."""

    @abstractmethod
    def load(self, manager: str, request: LoadRequest, timeout: float) -> None:
        """Set the parameters and load the nodelet, or start the node."""

    @abstractmethod
    def unload(self, manager: str, name: str) -> None:
        """Unload a nodelet, even while it is being loaded, or end a node.

        If its process dies of that, ``states`` shows it by the time that this raises.
        """

    @abstractmethod
    def moving(self, name: str, source: str, target: str) -> ContextManager[Callable[[], None]]:
        """Move a nodelet between nodelet managers; messages are kept for it until the end.

        Entering prepares, and changes nothing for the nodelet. The function that is returned
        unloads it in ``source``; then it is to be loaded in ``target``. Both raise HostError; if
        the function does, the nodelet may still run in ``source``.
        """

    @abstractmethod
    def set_parameter(self, name: str, parameter: Parameter) -> bool:
        """Set a private parameter of a nodelet; returns whether it has read it already."""

    @abstractmethod
    def forget(self, name: str, parameters: Sequence[str]) -> None:
        """Delete the parameters of these names that ``load`` set, and no other parameters."""

    @abstractmethod
    def list(self, manager: str) -> builtins.list[str]:
        """Return the names of the nodelets that a nodelet manager runs."""

    @abstractmethod
    def reported(self, manager: str, name: str) -> Reported | None:
        """Return a process's last report of a nodelet, without a call.

        It contains every connection that `connect` made before. None for a nodelet that the
        process does not run, or whose ports it does not know.
        """

    @abstractmethod
    def ports(self, name: str) -> tuple[PortState, ...]:
        """Ask for the ports of a nodelet that has a proxy."""

    @abstractmethod
    def connect(self, name: str, config: Mapping[str, str]) -> None:
        """Connect ports of a nodelet that has a proxy, all or none."""

    @abstractmethod
    def published(self, topics: Iterable[str]) -> frozenset[str]:
        """Return the topics that have a publisher now."""

    @abstractmethod
    def counts(
        self, wanted: Mapping[str, Collection[str]]
    ) -> dict[str, Mapping[str, Count] | None]:
        """Count the messages that nodelets have sent; their processes are queried side by side.

        A process that does not answer delays this by half a second, once: until its reply has come
        it is not waited for again. Names of nodelets are wanted by process.

        Returns:
        Counts by out-port for each nodelet; None for a nodelet that is not running. Nodelets
        without a reply yet are left out until a later call.
        """

    @abstractmethod
    def usage(self) -> Mapping[str, Usage]:
        """Return what each process has reported last that it has used, where it measures that."""

    @abstractmethod
    def widen(self, kind: NodeletKind) -> None:
        """Start one more shared nodelet manager; it comes up in the background."""

    def memory(self, manager: str) -> int:
        """Return the bytes of memory that a process takes; 0 if that is not known."""
        return 0

    @abstractmethod
    def is_stamped(self, datatype: str) -> bool | None:
        """Whether messages of a type bear a time stamp: begin with a header; None if not known."""

    @abstractmethod
    def verdicts(self, topics: Collection[str]) -> Mapping[str, HeardVerdict]:
        """Return the verdicts that were heard on some topics, by topic; does not wait.

        They are listened to from now on, until a call leaves them out.
        """

    @abstractmethod
    def listen(self, topic: str) -> Listening:
        """Subscribe to a topic in order to count its messages; does not wait."""
