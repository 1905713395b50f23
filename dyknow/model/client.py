# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The interface to a DyKnow manager, which all of its clients use.

``dyknow.ros.client.ManagerClient`` calls a manager of the ROS graph;
``dyknow.simulated.SimulatedManagerClient`` is one without ROS, for tests and pictures.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Mapping, Optional, Sequence, Tuple

from dyknow.model.graph import Model, ParameterSet, PortState, Restarted, SpawnRequest
from dyknow.model.hosts import AT, HostStatus
from dyknow.model.statistics import NodeletStatistics
from dyknow.model.streams import Acquisition, Replanned, StreamRequest, StreamStatus
from dyknow.model.transformation import Added, Parameter


class BaseManagerClient(ABC):
    """One DyKnow manager, and the proxies of its nodelets.

    Every method may block and raises ``DyKnowError``: ``Refused`` when the answer is no, in the
    manager's or the nodelet's words; ``HostError`` when it cannot be reached; ``PeerTimeout``
    when no answer comes in time.

    Attributes:
        manager: global name of the manager's node.
    """

    manager: str

    # Transformations

    @abstractmethod
    def add_transformation(self, specification: str) -> Added:
        """Add the transformations of a specification (XML text)."""

    @abstractmethod
    def remove_transformation(self, label: str) -> None:
        """Remove a transformation; nodelets made from it keep running."""

    # Nodelets

    @abstractmethod
    def spawn_nodelet(self, request: SpawnRequest) -> None:
        """Make a nodelet; it runs and is connected when this returns.

        A relative name begins in the manager's namespace.
        """

    def spawn(
        self,
        label: str,
        name: str,
        config: Optional[Mapping[str, str]] = None,
        is_protected: bool = False,
        isolated: bool = False,
        manager: str = "",
        parameters: Sequence[Parameter] = (),
    ) -> None:
        """Make a nodelet; the arguments are the fields of a ``SpawnRequest``."""
        self.spawn_nodelet(
            SpawnRequest(
                label, name, config or {}, is_protected, isolated, manager, tuple(parameters)
            )
        )

    @abstractmethod
    def destroy(self, name: str) -> None:
        """Destroy a nodelet."""

    @abstractmethod
    def restart(self, name: str) -> Restarted:
        """Restart a nodelet, or a nodelet manager of the manager's with all its nodelets.

        They run today's code, as the library specifies them today, with their parameters,
        connections and protection. Messages that come meanwhile are lost to them.
        """

    @abstractmethod
    def set_parameter(self, name: str, parameter: Parameter) -> ParameterSet:
        """Set a private parameter of a nodelet for life, as if it were given at the spawn.

        An empty type is the transformation's, or follows from the text.
        """

    @abstractmethod
    def set_protection(self, name: str, is_protected: bool) -> None:
        """Protect a nodelet from being destroyed, or release it."""

    @abstractmethod
    def connect(self, moves: Sequence[Tuple[str, Mapping[str, str]]]) -> None:
        """Connect ports of nodelets in this order, all or none; the model shows it at once.

        The moves are names of nodelets, each with topics by port; an empty topic disconnects.
        """

    @abstractmethod
    def get_model(self) -> Model:
        """Return the nodelets and the transformations."""

    def get_graph(self) -> Model:
        """Return the nodelets; the transformations, which may be many, may be left out."""
        return self.get_model()

    @abstractmethod
    def nodelet_managers(self) -> Sequence[str]:
        """Return the global names of the nodelet managers that it may use and are up, sorted."""

    @abstractmethod
    def list_hosts(self) -> Tuple[HostStatus, ...]:
        """Return the hosts of the processes that the manager knows, by name."""

    def places(self) -> Sequence[str]:
        """Return where a spawn may ask to be: nodelet managers, and ``@HOST`` for each host."""
        hosts = (AT + each.name for each in self.list_hosts() if not each.is_away)
        return [*self.nodelet_managers(), *hosts]

    # Proxies

    @abstractmethod
    def get_config(self, nodelet: str) -> Tuple[PortState, ...]:
        """Return the ports of a nodelet, without their tags."""

    @abstractmethod
    def set_config(self, nodelet: str, config: Mapping[str, str]) -> None:
        """Connect ports of a nodelet to topics, all or none; an empty topic disconnects."""

    @abstractmethod
    def get_statistics(self, nodelet: str) -> NodeletStatistics:
        """Return the counts of a nodelet."""

    # Streams

    @abstractmethod
    def acquire_stream(self, request: StreamRequest, dry_run: bool = False) -> Acquisition:
        """Request a stream, or with ``dry_run`` only its plan.

        Raises:
            StreamRefused: it cannot be made now; the claim that it names waits until it can.
        """

    @abstractmethod
    def release_stream(self, claim_id: str) -> None:
        """End a claim; ending it again has no effect."""

    @abstractmethod
    def renew_stream(self, claim_id: str, lease: float) -> float:
        """Renew the lease of a claim: seconds from now, 0 for until it is released.

        Returns:
            When it ends, in seconds of ROS time; 0 for until it is released.
        """

    @abstractmethod
    def replan_stream(self, claim_id: str, dry_run: bool = False) -> Replanned:
        """Switch to the cheapest plan of now, or with ``dry_run`` only describe it."""

    @abstractmethod
    def plan_stream(self, claim_id: str, exclude: Sequence[str]) -> Replanned:
        """Describe the cheapest plan for a claim without some transformations (labels)."""

    @abstractmethod
    def list_streams(self) -> Tuple[StreamStatus, ...]:
        """Return all claims, and those that ended lately."""

    @abstractmethod
    def find_bindings(self, tag: str, datatype: str = "") -> Tuple[str, ...]:
        """Return the bindings under which a tag's stream exists or, verdicts aside, can be made.

        Returns:
            For each binding its variables, such as ``?camera=left, ?robot=nao``. A tag without
            variables has one binding, the empty text, or none.
        """
