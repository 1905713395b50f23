# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A simulated manager as the window sees it: for tests of the window, and for its pictures."""

from __future__ import annotations

import contextlib
from typing import AbstractSet, Callable, Collection, Dict, Iterable, List, Tuple

from dyknow.errors import HostError, PeerTimeout
from dyknow.formulas import Truth, Verdict
from dyknow.model.graph import Model
from dyknow.periodic import PeriodicWorker
from dyknow.simulated import SimulatedManagerClient
from dyknow_rqt.graph.samples import Sample
from dyknow_rqt.graph.snapshot import Side, Transports
from dyknow_rqt.remote import Remote

#: Seconds.
_COUNTS_PERIOD = 0.3


class SimulatedRemote(Remote):
    """A simulated manager, with ordinary nodes beside it.

    Attributes:
        has_master: whether the master answers.
        address: that of the manager at the master; empty if the master does not know it.
        publishers: nodes that publish, by topic.
        subscribers: nodes that subscribe, by topic.
        connected: transports of connections to other processes.
        followed: nodes and topics whose verdicts are heard.
        listeners: those that the user looks at, by topic.
    """

    def __init__(self) -> None:
        """Start empty, with a master and a manager that are up."""
        super().__init__("http://localhost:11311")
        self.has_master = True
        self.address = "rosrpc://localhost:40001"
        self.client: SimulatedManagerClient = SimulatedManagerClient()
        self.publishers: Dict[str, List[str]] = {}
        self.subscribers: Dict[str, List[str]] = {}
        self.connected: Transports = {}
        self.followed: AbstractSet[Tuple[str, str]] = frozenset()
        self.listeners: Dict[str, List[Callable[[Sample], None]]] = {}
        self._samples: Dict[str, Sample] = {}
        self._verdicts: Dict[str, Verdict] = {}
        self._counting = PeriodicWorker("simulated counts", self._count, _COUNTS_PERIOD)

    def start(self) -> None:
        self.client.on_model, self.client.on_event = self.on_model, self.on_event
        self._counting.start()

    def follow_verdicts(self, sources: AbstractSet[Tuple[str, str]]) -> None:
        self.followed = sources
        self._hand_on(self._verdicts)

    def decide(self, topic: str, truth: Truth, since: int = 0, why: str = "") -> None:
        """Let a verdict come, from ``since`` on; as from a nodelet, the last one is latched."""
        self._verdicts[topic] = Verdict(since, truth, since, why)
        self._hand_on([topic])

    def follow(
        self, topic: str, datatype: str, node: str, on_sample: Callable[[Sample], None]
    ) -> Callable[[], None]:
        listeners = self.listeners.setdefault(topic, [])
        listeners.append(on_sample)
        if topic in self._samples:
            on_sample(self._samples[topic])

        def end() -> None:
            if on_sample in listeners:
                listeners.remove(on_sample)

        return end

    def send(self, topic: str, sample: Sample) -> None:
        """Let a message come; the last one is latched."""
        self._samples[topic] = sample
        for listener in list(self.listeners.get(topic, ())):
            listener(sample)

    def close(self) -> None:
        self.client.on_model = lambda model: None
        self.client.on_event = lambda event: None
        self._counting.close()

    def graph(self) -> Model:
        return self.client.get_graph()

    def system_state(self) -> Tuple[Side, Side]:
        """Return the ordinary nodes only."""
        self._ask_master()
        return sorted(self.publishers.items()), sorted(self.subscribers.items())

    def find_manager(self) -> str:
        self._ask_master()
        return self.address

    def transports(self, nodes: Collection[str]) -> Transports:
        return {key: names for key, names in self.connected.items() if key[0] in nodes}

    def _count(self) -> None:
        with contextlib.suppress(HostError):
            self.on_counts(self.client.counts())

    def _hand_on(self, topics: Iterable[str]) -> None:
        followed = {topic for _, topic in self.followed}
        for topic in followed.intersection(topics):
            self.on_verdict(topic, self._verdicts[topic])

    def _ask_master(self) -> None:
        if not self.has_master:
            raise PeerTimeout(f"the ROS master at {self.master}", 3.0)
