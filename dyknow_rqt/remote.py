"""The seam between the window and the rest of the world.

The real one is ``ros_remote``; ``simulated`` stands beside it, for tests and pictures.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Callable, Mapping, Optional, Sequence, Tuple

from dyknow_rqt.graph.snapshot import Side

if TYPE_CHECKING:
    from dyknow.model.graph import Model, PortState
    from dyknow.model.statistics import NodeletStatistics
    from dyknow.model.streams import (
        Acquisition,
        Replanned,
        StreamEvent,
        StreamRequest,
        StreamStatus,
    )
    from dyknow.model.transformation import Added


class Remote(ABC):
    """A DyKnow manager, the proxies of its nodelets, and the ROS master.

    Every method but ``start`` and ``close`` may block and is called in worker threads. They raise
    ``DyKnowError``: ``Refused`` with the words of the manager, ``HostError`` and ``PeerTimeout``
    when nobody answers. What they return are values of ``dyknow.ros.client``.
    """

    #: Global name of the manager.
    manager: str = ""

    @abstractmethod
    def start(
        self,
        on_model: Callable[[Model], None],
        on_event: Callable[[StreamEvent], None],
    ) -> None:
        """Listen to the model and to the events of streams; each is handed on, in any thread."""

    @abstractmethod
    def close(self) -> None:
        """Listen no more; returns at once."""

    @abstractmethod
    def graph(self) -> Model:
        """What runs; the transformations may be left out."""

    @abstractmethod
    def library(self) -> Model:
        """What runs and all that can run."""

    @abstractmethod
    def ports(self, nodelet: str) -> Sequence[PortState]:
        """The ports of a nodelet, as it says itself."""

    @abstractmethod
    def statistics(self, nodelet: str) -> NodeletStatistics:
        """What a nodelet has done."""

    @abstractmethod
    def system_state(self) -> Tuple[Side, Side]:
        """Publishers and subscribers of all topics, as the master knows them."""

    @abstractmethod
    def nodelet_managers(self) -> Sequence[str]:
        """Names of the nodelet managers that are up."""

    @abstractmethod
    def add_transformation(self, specification: str) -> Added:
        """Add what a specification says."""

    @abstractmethod
    def remove_transformation(self, label: str) -> None:
        """Remove a transformation."""

    @abstractmethod
    def spawn(
        self,
        label: str,
        name: str,
        config: Optional[Mapping[str, str]] = None,
        is_protected: bool = False,
        isolated: bool = False,
        manager: str = "",
    ) -> None:
        """Make a nodelet."""

    @abstractmethod
    def destroy(self, name: str) -> None:
        """End a nodelet."""

    @abstractmethod
    def set_protection(self, name: str, is_protected: bool) -> None:
        """Protect a nodelet, or release it."""

    @abstractmethod
    def set_config(self, nodelet: str, config: Mapping[str, str]) -> None:
        """Connect ports of a nodelet, all or none; an empty topic disconnects."""

    @abstractmethod
    def acquire_stream(self, request: StreamRequest, dry_run: bool = False) -> Acquisition:
        """Ask for a stream, or how it would be made; raises ``StreamRefused`` if it cannot be."""

    @abstractmethod
    def release_stream(self, claim_id: str) -> None:
        """End a claim."""

    @abstractmethod
    def replan_stream(self, claim_id: str, dry_run: bool = False) -> Replanned:
        """Take the cheapest way, or say which that is."""

    @abstractmethod
    def streams(self) -> Sequence[StreamStatus]:
        """All claims, those that ended lately too."""
