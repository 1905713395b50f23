# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The seam between the window and the rest of the world.

The real one is ``ros_remote``; ``simulated`` stands beside it, for tests and pictures.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import AbstractSet, Callable, Collection, Sequence

from dyknow.formulas import Verdict
from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import Model
from dyknow.model.statistics import NodeletCount
from dyknow.model.streams import StreamEvent
from dyknow_rqt.graph.samples import Sample
from dyknow_rqt.graph.snapshot import Side, Transports


class Remote(ABC):
    """A DyKnow manager with its announcements, and the ROS master.

    Every method but ``start``, ``follow_verdicts`` and ``close`` may block and is called in worker
    threads. They raise the exceptions of the client's methods.

    Messages are handed on in any thread, to functions that are set before ``start``.

    Attributes:
        client: speaks with the manager and the proxies of its nodelets.
        master: address of the master.
        on_model: takes the graph after each change.
        on_event: takes each event of a stream.
        on_verdict: takes a topic and its verdict, each as the first of the equal ones.
        on_counts: takes counts and health of all nodelets, once a second.
    """

    client: BaseManagerClient

    def __init__(self, master: str) -> None:
        self.master = master
        self.on_model: Callable[[Model], None] = lambda model: None
        self.on_event: Callable[[StreamEvent], None] = lambda event: None
        self.on_verdict: Callable[[str, Verdict], None] = lambda topic, verdict: None
        self.on_counts: Callable[[Sequence[NodeletCount]], None] = lambda counts: None

    @property
    def manager(self) -> str:
        """Global name of the manager."""
        return self.client.manager

    @abstractmethod
    def start(self) -> None:
        """Listen to the model, events of streams and counts."""

    @abstractmethod
    def follow_verdicts(self, sources: AbstractSet[tuple[str, str]]) -> None:
        """Listen to the verdicts of these nodes on these topics alone.

        It returns at once, and is called after ``start`` in the thread of the window.
        """

    @abstractmethod
    def follow(
        self, topic: str, datatype: str, node: str, on_sample: Callable[[Sample], None]
    ) -> Callable[[], None]:
        """Listen to a topic of a node, and hand on its messages, reduced, at most five a second.

        The type is empty if it is unknown. Returns a function that stops listening, at once.
        """

    @abstractmethod
    def close(self) -> None:
        """Listen no more; returns at once."""

    @abstractmethod
    def graph(self) -> Model:
        """Return the graph, as it was received last or else as the manager answers."""

    @abstractmethod
    def system_state(self) -> tuple[Side, Side]:
        """Ask the master for the publishers and subscribers of all topics."""

    @abstractmethod
    def find_manager(self) -> str:
        """Ask the master for the manager's address, and turn to the manager that is there.

        The address is empty if the master does not know the manager.
        """

    @abstractmethod
    def transports(self, nodes: Collection[str]) -> Transports:
        """Ask nodes for the transports of their connections to other processes."""
