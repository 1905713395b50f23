# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The interface to a DyKnow manager: everything outside the manager speaks with it through this.

``dyknow.ros.client.ManagerClient`` speaks with a manager of the ROS graph;
``dyknow.simulated.SimulatedManagerClient`` is one without ROS, for tests and pictures.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Mapping, Optional, Sequence, Tuple

from dyknow.model.graph import Model, PortState, SpawnRequest
from dyknow.model.statistics import NodeletStatistics
from dyknow.model.streams import Acquisition, Replanned, StreamRequest, StreamStatus
from dyknow.model.transformation import Added, Parameter


class BaseManagerClient(ABC):
    """One DyKnow manager, and the proxies of its nodelets.

    Every method may block and raises ``DyKnowError``: ``Refused`` when the answer is no, in the
    manager's or the nodelet's words; ``HostError`` when nobody is there to answer; ``PeerTimeout``
    when no answer comes in time.

    Attributes:
        manager: global name of the manager's node.
    """

    manager: str

    # Transformations

    @abstractmethod
    def add_transformation(self, specification: str) -> Added:
        """Add what a specification (XML text) says."""

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
    def set_protection(self, name: str, is_protected: bool) -> None:
        """Protect a nodelet from being destroyed, or release it."""

    @abstractmethod
    def get_model(self) -> Model:
        """Ask what runs and what can run."""

    def get_graph(self) -> Model:
        """Ask what runs; the transformations, which may be many, may be left out."""
        return self.get_model()

    @abstractmethod
    def nodelet_managers(self) -> Sequence[str]:
        """Ask for the global names of the nodelet managers that are up, sorted."""

    # Proxies

    @abstractmethod
    def get_config(self, nodelet: str) -> Tuple[PortState, ...]:
        """Ask a nodelet for its ports; it does not know their tags."""

    @abstractmethod
    def set_config(self, nodelet: str, config: Mapping[str, str]) -> None:
        """Connect ports of a nodelet to topics, all or none; an empty topic disconnects."""

    @abstractmethod
    def get_statistics(self, nodelet: str) -> NodeletStatistics:
        """Ask a nodelet what it has done."""

    # Streams

    @abstractmethod
    def acquire_stream(self, request: StreamRequest, dry_run: bool = False) -> Acquisition:
        """Ask for a stream, or with ``dry_run`` for how it would be made.

        Raises:
            StreamRefused: it cannot be made now; the claim that it names waits until it can.
        """

    @abstractmethod
    def release_stream(self, claim_id: str) -> None:
        """End a claim; ending it again is no error."""

    @abstractmethod
    def renew_stream(self, claim_id: str, lease: float) -> float:
        """Let a claim live for so many seconds from now, 0 for until it is released.

        Returns:
            When it ends, in seconds of ROS time; 0 for until it is released.
        """

    @abstractmethod
    def replan_stream(self, claim_id: str, dry_run: bool = False) -> Replanned:
        """Take the way that is the cheapest now, or with ``dry_run`` ask which that is."""

    @abstractmethod
    def list_streams(self) -> Tuple[StreamStatus, ...]:
        """Ask for all claims, those that ended lately too."""

    @abstractmethod
    def find_bindings(self, tag: str, datatype: str = "") -> Tuple[str, ...]:
        """Ask for which names a stream of a tag is there or can be made.

        Returns:
            For each way what the variables stand for, such as ``?camera=left, ?robot=nao``. A tag
            without variables has one way, the empty text, or none.
        """
