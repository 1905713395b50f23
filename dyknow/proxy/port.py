# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ports: the state objects of the paper's figure 2.

A port lives as long as its nodelet, while handles on it come and go: it keeps its type and its
topic, so a handle that is made later has the same connection.

The port of an image may have a *companion*, for the same images in another form (``Codec``): port
``image/compressed``, on a topic below that of the image. It moves with its port. An in-port with a
companion receives through it alone; an out-port publishes both.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Callable, Sequence

from dyknow import names
from dyknow.locks import state_lock
from dyknow.model.graph import PortState
from dyknow.model.statistics import PortStatistics
from dyknow.model.transformation import IN, OUT
from dyknow.nodelet.context import Context
from dyknow.nodelet.middleware import Codec
from dyknow.nodelet.streams.bus import Endpoint
from dyknow.nodelet.streams.endpoints import NOTHING, Publication, Traffic
from dyknow.nodelet.streams.pubsub import Publisher, Subscriber
from dyknow.nodelet.timers import Timer

#: Seconds without a message after which an in-port with a companion looks for publishers.
_SILENCE = 5.0

_log = logging.getLogger("rosout.dyknow")


class ProxyPort:
    """A named place of a nodelet that can be connected to a topic, or to none (empty)."""

    direction = ""
    codec: Codec | None = None  # encodes messages for the companion, if there is one
    companion: Any = None  # a port of the same kind
    is_companion = False

    def __init__(self, name: str, datatype: Any, topic: str) -> None:
        self.name = name
        self.datatype = datatype
        self.topic = topic
        self.handles: list[Any] = []
        self._traffics: list[Traffic] = []
        self._free: list[Traffic] = []

    def accompany(self, codec: Codec) -> None:
        """Make the companion."""
        name = f"{self.name}/{codec.form}"
        self.codec = codec
        self.companion = type(self)(name, codec.datatype, names.below(self.topic, codec.form))
        self.companion.is_companion = True

    @property
    def parts(self) -> tuple[Any, ...]:
        """The port and its companion."""
        return (self,) if self.companion is None else (self, self.companion)

    def takes_along(self, topic: str) -> str | None:
        """Where the companion goes when the port moves to a topic; None if it stays."""
        form = self.codec.form if self.codec is not None else ""
        if not form or self.companion.topic != names.below(self.topic, form):
            return None
        return names.below(topic, form)

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
        """Whether the nodelet is notified of its subscribers."""
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

    def open(
        self, context: Context, latch: bool, queue_size: int | None, options: dict[str, Any]
    ) -> None:
        """Make the publication, and that of the companion."""
        for part in self.parts:
            publication = context.publication(
                part.name, part.datatype, latch, queue_size, **options
            )
            part.publication = publication
            part.count(publication)

    def endpoints(self) -> Sequence[Endpoint]:
        return () if self.publication is None else (self.publication,)

    def statistics(self) -> PortStatistics:
        statistics, publication = super().statistics(), self.publication
        if publication is None:
            return statistics
        latched = publication.latched is not NOTHING
        age, size = publication.sample()
        return replace(statistics, latched=latched, age=age, size=size)


class InPort(ProxyPort):
    """A port that receives; each handle has its own callbacks and queue."""

    direction = IN

    def accompany(self, codec: Codec) -> None:
        """Make the companion, to which the subscriptions belong as well."""
        super().accompany(codec)
        self.companion.handles, self.companion._traffics = self.handles, self._traffics

    def endpoints(self) -> Sequence[Endpoint]:
        if self.companion is not None:
            return ()
        return tuple(handle.subscription for handle in self.handles)


@dataclass(frozen=True)
class _EncodedPeer:
    """A subscriber of encoded messages, among the peers of both publications."""

    peer: Any


class EncodingPublication:
    """Stands for two publications where a handle expects one; ``port`` is the companion.

    The publishing thread encodes a message, once, and only while the encoded form has a
    subscriber or is latched. A message that cannot be encoded is counted and logged as an
    error of the nodelet; plainly it was sent.
    """

    def __init__(self, context: Context, port: Any, plain: Publication, codec: Codec) -> None:
        self._context = context
        self._what = f"'{port.name}'"
        self._plain = plain
        self._encoded: Publication = port.publication
        self._codec = codec
        self.datatype = plain.datatype
        self.refusal = plain.refusal

    @property
    def topic(self) -> str:
        """The topic of the plain messages."""
        return self._plain.topic

    def publish(self, message: Any = NOTHING, /, *fields: Any, **named: Any) -> None:
        """Publish a message in both forms; like ``Publication.publish``."""
        if message.__class__ is not self.datatype or fields or named:
            message = self._plain.built(message, fields, named)
        self._plain.publish(message)
        if self._encoded.heard:
            self._send_encoded(message, self._encoded.publish)

    def publish_to(self, topic: str, peer: Any, message: Any) -> None:
        """Send a message to one of the ``peers`` of a topic, in the form that it subscribes to."""
        if not isinstance(peer, _EncodedPeer):
            self._plain.publish_to(topic, peer, message)
        elif topic == self._plain.topic:
            encoded = self._encoded
            self._send_encoded(
                message, lambda form: encoded.publish_to(encoded.topic, peer.peer, form)
            )

    def peers(self) -> tuple[str, tuple[Any, ...]]:
        """The topic, and the subscribers of both forms."""
        topic, plain = self._plain.peers()
        encoded = self._encoded.peers()[1]
        return topic, (*plain, *map(_EncodedPeer, encoded))

    def watch(self, changed: Callable[[], None]) -> None:
        """Call ``changed`` whenever ``peers`` may have changed."""
        for each in (self._plain, self._encoded):
            each.watch(changed)

    def unwatch(self, changed: Callable[[], None]) -> None:
        for each in (self._plain, self._encoded):
            each.unwatch(changed)

    def _send_encoded(self, message: Any, send: Callable[[Any], None]) -> None:
        try:
            form = self._codec.encode(message)
        except Exception as error:  # the boundary: a callback never ends by an image of another
            self._encoded.drop()
            self._context.failed(self._what, error)
            return
        send(form)


class PortPublisher(Publisher):
    """A handle on an out-port."""

    def __init__(self, context: Context, port: OutPort, listener: Any = None) -> None:
        publication: Any = port.publication
        if port.codec is not None:
            publication = EncodingPublication(context, port.companion, publication, port.codec)
        self._port = port
        super().__init__(context, port.name, publication, listener)
        port.handles.append(self)

    def _moves(self, topic: str) -> Sequence[tuple[Endpoint, str]]:
        return [(each, part.topic) for part in self._port.parts for each in part.endpoints()]

    def _withdraw(self) -> None:
        """Withdraw the publications with the last handle; the port stays."""
        port, last = self._port, []
        with port.lock:
            if self in port.handles:
                port.handles.remove(self)
                if not port.handles:
                    last = [(part, part.publication) for part in port.parts]
                    for part in port.parts:
                        part.publication = None
        if last:
            self._context.release(*(publication for _, publication in last))
        for part, publication in last:
            part.leave(publication)


class PortSubscriber(Subscriber):
    """A handle on an in-port."""

    def __init__(self, context: Context, port: InPort, *args: Any, **options: Any) -> None:
        super().__init__(context, port.name, *args, codec=port.codec, **options)
        self._port = port
        self._received: int | None = 0
        self._told = ""  # the topic that was warned of
        self._looks: Timer | None = None
        port.handles.append(self)
        port.count(self.subscription)
        if port.codec is not None:
            strand = context.new_strand(f"looks of '{port.name}'")
            look = partial(self._look, port.codec.form)
            self._looks = context.timer(_SILENCE, look, strand, oneshot=False)

    @property
    def name(self) -> str:
        """Global name of the topic that the port is connected to now."""
        return self._port.topic if self.subscription.topic else ""

    resolved_name = name

    def _moves(self, topic: str) -> Sequence[tuple[Endpoint, str]]:
        return [(self.subscription, self._port.parts[-1].topic)]

    def _look(self, kind: str, event: Any) -> None:
        """Warn, once, of a topic whose publishers do not send the form that the port receives."""
        received, self._received = self._received, self._port.statistics().messages
        topic, form = (part.topic for part in self._port.parts)
        if received != self._received or topic == self._told or self not in self._port.handles:
            return
        is_published = self._context.runtime.transport.is_published
        if topic and is_published(topic) and not is_published(form):
            self._told = topic
            _log.warning(
                "%s: nothing comes to port '%s': %s is published, but %s is not; set "
                "image_transport of its publisher to %s, or that of this port to raw",
                *(self._context.name, self._port.name, topic, form, kind),
            )

    def unregister(self) -> None:
        joined = self in self._port.handles
        if joined:
            self._port.handles.remove(self)  # first: a switch leaves it out from now on
        super().unregister()
        if joined:
            self._port.leave(self.subscription)
        if self._looks is not None:
            self._looks.shutdown()
            self._context.drop_strand(self._looks.strand)
