# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ports: the state objects of the paper's figure 2.

A port lives as long as its nodelet, while handles on it come and go: it keeps its type and its
topic, so a handle that is made later has the same connection.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Sequence

from dyknow.locks import state_lock
from dyknow.model.graph import PortState
from dyknow.model.statistics import PortStatistics
from dyknow.model.transformation import IN, OUT
from dyknow.nodelet.bus import Endpoint
from dyknow.nodelet.context import Context
from dyknow.nodelet.endpoints import NOTHING, Publication, Traffic
from dyknow.nodelet.pubsub import Publisher, Subscriber


class ProxyPort:
    """A named place of a nodelet that can be connected to a topic, or to none (empty)."""

    direction = ""

    def __init__(self, name: str, datatype: Any, topic: str) -> None:
        self.name = name
        self.datatype = datatype
        self.topic = topic
        self.handles: list[Any] = []
        self._traffics: list[Traffic] = []
        self._free: list[Traffic] = []

    @property
    def state(self) -> PortState:
        """The port at this moment, without tags: only the transformation knows those."""
        return PortState(self.name, self.direction, self.datatype._type, self.topic)

    @property
    def kind(self) -> str:
        """Direction and type, for errors."""
        return f"{self.direction}-port of type {self.datatype._type}"

    @property
    def is_watched(self) -> bool:
        """Whether the nodelet is told of its subscribers."""
        return False

    def endpoints(self) -> Sequence[Endpoint]:
        """The endpoints that move when the port is connected elsewhere."""
        raise NotImplementedError

    def count(self, endpoint: Endpoint) -> None:
        """Count the messages of ``endpoint``, continuing the counts of one that has left."""
        if self._free:
            endpoint.traffic = self._free.pop()
        else:
            self._traffics.append(endpoint.traffic)

    def leave(self, endpoint: Endpoint) -> None:
        self._free.append(endpoint.traffic)

    def statistics(self) -> PortStatistics:
        traffics = self._traffics
        calls = sum(each.messages for each in traffics)
        busiest = max(traffics, key=lambda each: each.messages, default=None)
        return PortStatistics(
            self.name,
            self.direction,
            self.topic,
            messages=busiest.messages if busiest is not None else 0,
            dropped=max((each.dropped for each in traffics), default=0),
            rate=busiest.rate() if busiest is not None else 0.0,
            mean_callback=sum(each.busy for each in traffics) / calls if calls else 0.0,
            max_callback=max((each.longest for each in traffics), default=0.0),
        )


class OutPort(ProxyPort):
    """A port that sends; all handles share one publication."""

    direction = OUT

    def __init__(self, name: str, datatype: Any, topic: str) -> None:
        super().__init__(name, datatype, topic)
        self.publication: Publication | None = None
        #: Held while handles come and go: a new one must not share a publication that the last
        #: one is about to withdraw.
        self.lock = state_lock("port")

    @property
    def is_watched(self) -> bool:
        return any(handle.is_watched for handle in self.handles)

    def endpoints(self) -> Sequence[Endpoint]:
        return () if self.publication is None else (self.publication,)

    def statistics(self) -> PortStatistics:
        statistics, publication = super().statistics(), self.publication
        if publication is None:
            return statistics
        latched = publication.latched is not NOTHING
        return replace(statistics, latched=latched, age=publication.sample_age())


class InPort(ProxyPort):
    """A port that receives; each handle has its own callbacks and queue."""

    direction = IN

    def endpoints(self) -> Sequence[Endpoint]:
        return tuple(handle.subscription for handle in self.handles)


class PortPublisher(Publisher):
    """A handle on an out-port."""

    def __init__(
        self, context: Context, port: OutPort, publication: Publication, listener: Any = None
    ) -> None:
        super().__init__(context, port.name, publication, listener)
        self._port = port
        port.handles.append(self)
        if port.publication is None:
            port.publication = publication
            port.count(publication)

    def _withdraw(self) -> None:
        """Withdraw the publication with the last handle; the port stays."""
        port, last = self._port, None
        with port.lock:
            if self in port.handles:
                port.handles.remove(self)
                if not port.handles:
                    last, port.publication = port.publication, None
        if last is not None:
            self._context.release(last)
            port.leave(last)


class PortSubscriber(Subscriber):
    """A handle on an in-port."""

    def join(self, port: InPort) -> None:
        self._port = port
        port.handles.append(self)
        port.count(self.subscription)

    def unregister(self) -> None:
        joined = self in self._port.handles
        if joined:
            self._port.handles.remove(self)  # first: a switch leaves it out from now on
        super().unregister()
        if joined:
            self._port.leave(self.subscription)
