# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The in-process bus: which publications and connections meet on which topic.

The bus owns the table of topics; nothing else changes it. The table and the routes change under
the lock of the bus, in memory only. Everything that talks to ROS happens before (make) or after
(break) that, without the lock.

A switch (``rewire``) goes through four steps:

1. make: new connections are linked, held. Where a topic has no other end in this process, its
   registration is made now, and its peers outside are waited for. Where this process is registered
   already, the registration is shared, without a wait;
2. switch: publications get their new route in one store each, old connections close, the marker
   goes into the strand, new connections open;
3. register: topics with other ends in this process alone have switched already; their
   registrations are made now. What is published until then is kept for the outside;
4. break: the registrations of the old topics are drained and withdrawn. Where the first message
   of one publisher has made a switch, its other publishers are waited for now.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field
from typing import Any, Callable, Mapping, Sequence, Union

from dyknow.errors import HandleClosed, TypeMismatch
from dyknow.locks import state_lock
from dyknow.nodelet.middleware import OutsidePublisher, OutsideSubscriber, Transport
from dyknow.nodelet.scheduler import Clock
from dyknow.nodelet.streams.awaited import AwaitedPublisher
from dyknow.nodelet.streams.endpoints import NOTHING, Connection, Fence, Publication, Subscription
from dyknow.nodelet.streams.parked import ParkedConnection
from dyknow.periodic import NO_THREAD, in_background

#: How long the registration of an old topic stays at most while its messages are being sent, in s.
_LONGEST_DRAIN = 30.0
_RELEASE_DRAIN = 0.2  # how long `release()` waits for queued messages to be sent, in seconds
#: After such a wait timed out, skip it for this long: some subscriber is stalled.
_DRAIN_PAUSE = 2.0
#: Seconds for receiving what old publishers have sent; it has come to this machine already.
_LONGEST_DRAIN_IN = 0.1

Endpoint = Union[Publication, Subscription]

_log = logging.getLogger("rosout.dyknow")


@dataclass
class _Topic:
    """The ends of a topic in this process."""

    datatype: Any
    publications: list[Publication] = field(default_factory=list)
    route: tuple[Connection, ...] = ()


@dataclass(eq=False)
class _Part:
    """One endpoint's part in a switch, filled in as the steps are taken."""

    endpoint: Any  # a publication or a subscription
    topic: str  # its new topic; empty for none
    link: Connection | None = None  # the new connection of a subscription
    registration: Any = None  # on the new topic
    is_live: bool = False  # whether the topic has other ends in this process
    is_late: bool = False  # whether the registration is made after the switch
    #: Of a publication, takes its place until then, and while a latched message is sent.
    awaited: AwaitedPublisher | None = None
    drained: Connection | None = None  # receives no more from outside, until the switch
    old: Any = None  # registration on the topic that the endpoint leaves
    before: int = 0  # messages that a publication had published at the switch

    @property
    def is_publication(self) -> bool:
        return isinstance(self.endpoint, Publication)

    def check_open(self) -> None:
        if self.endpoint.closed:
            raise HandleClosed(f"an endpoint of topic '{self.topic}'")


class Bus:
    """Delivers by reference between the endpoints of one process; ``transport`` is the outside.

    ``check_topic`` raises Denied if nothing must be connected to a topic. It is called for every
    endpoint of the process.
    """

    def __init__(
        self,
        transport: Transport,
        clock: Clock = time.monotonic,
        check_topic: Callable[[str], None] | None = None,
    ) -> None:
        self._transport = transport
        self._check_topic = check_topic
        self._clock = clock
        self._lock = state_lock("bus")
        self._topics: dict[str, _Topic] = {}
        self._making: list[_Part] = []
        self._parked: list[_Part] = []
        self._leaving: list[tuple[Endpoint, OutsidePublisher]] = []
        self._patient_from = clock()
        self._fences: Mapping[str, Fence] = {}

    def datatype_of(self, topic: str) -> str:
        """Type name of a topic that is alive, in this process or outside; empty if it is not."""
        with self._lock:
            present = self._topics.get(topic)
            if present is not None and present.datatype._type != "*":
                return str(present.datatype._type)
        return self._transport.datatype_of(topic)

    def owners(self, topic: str) -> tuple[list[str], list[str]]:
        """Nodelets of this process that publish on a topic, and those that subscribe to it."""
        with self._lock:
            present = self._topics.get(topic, _Topic(None))
            publishers = {each.owner for each in present.publications}
            return sorted(publishers), sorted({each.subscription.owner for each in present.route})

    def latched(self, topic: str) -> list[Any]:
        """Return the messages that publications of this process latch on a topic now."""
        with self._lock:
            present = self._topics.get(topic, _Topic(None))
            messages = [each.latched for each in present.publications]
        return [each for each in messages if each is not NOTHING]

    def fence(self, fences: Mapping[str, Fence]) -> None:
        """Set the fences that messages have to pass, by topic; other topics are open to all."""
        with self._lock:
            self._fences = fences
            for name, topic in self._topics.items():
                for publication in topic.publications:
                    publication.set_fence(fences.get(name))

    def rewire(
        self,
        moves: Sequence[tuple[Endpoint, str]],
        on_switch: Callable[[], None] = lambda: None,
        patience: float = 0.0,
    ) -> None:
        """Connect every endpoint to its new topic (empty: to none), all in one switch.

        Args:
            moves: endpoint and global topic name; an endpoint that is on its topic already
                stays untouched.
            on_switch: called at the switch, after the last old and before the first new message
                can be queued. The lock of the bus is held: it may only queue something.
            patience: seconds to wait, in all, for peers outside.

        Raises:
            Denied: a guard forbids a topic; nothing was changed.
            TypeMismatch: a topic has another type in this process; nothing was changed.
            HandleClosed: an endpoint was released meanwhile; nothing was changed.
            Exception: a registration failed; nothing was changed, unless ``on_switch`` was called.
        """
        parts = [_Part(endpoint, topic) for endpoint, topic in moves if endpoint.topic != topic]
        for part in parts:
            if part.topic and self._check_topic is not None:
                self._check_topic(part.topic)
        deadline = self._clock() + patience
        try:
            self._make(parts, deadline, patience)
            self._drain(parts, patience)
            self._switch(parts, on_switch)
        except BaseException:
            self._undo(parts)
            raise
        try:
            self._register_late(parts, patience)
        finally:
            self._break(parts, deadline)
        for part in parts:
            left = deadline - self._clock() if patience else 0.0
            is_new = part.is_late or not part.is_live  # else the process is connected already
            if part.link is not None and part.registration is not None and is_new and left > 0:
                part.registration.wait_for_all(left)

    def release(self, endpoints: Sequence[Endpoint]) -> None:
        """Take endpoints off the bus for good: messages that wait for them are dropped.

        Messages that they have published are sent first, as far as the network takes them soon.
        """
        with self._lock:
            made = [part.registration for part in self._making if part.endpoint in endpoints]
            made += [old for endpoint, old in self._leaving if endpoint in endpoints]
            self._leaving = [each for each in self._leaving if each[0] not in endpoints]
            for endpoint in endpoints:
                made.append(endpoint.outside)
                if isinstance(endpoint, Publication):
                    self._leave(endpoint)
                    endpoint.close()
                else:
                    endpoint.closed = True
                    connection, endpoint.connection = endpoint.connection, None
                    self._unlink(connection, discard=True)
        now = self._clock()
        deadline = now + _RELEASE_DRAIN if now >= self._patient_from else now
        for registration in made:
            if isinstance(registration, OutsidePublisher):
                left = max(0.0, deadline - self._clock())
                if not registration.drain(left) and left:
                    self._patient_from = self._clock() + _DRAIN_PAUSE
            if registration is not None:
                registration.close()

    # Nodelets that move to another process, or come from one

    def detach(
        self, connections: Sequence[Connection], staying: Sequence[tuple[Publication, str]]
    ) -> list[OutsideSubscriber] | None:
        """Disconnect subscriptions, all or none; their queued messages stay.

        ``staying`` are publications of the same nodelet, with their topics. Returns registrations,
        which the caller withdraws; None if an end is connected elsewhere, or is about to be.
        """
        with self._lock:
            moving = [part.endpoint for part in self._making]
            ends: list[Endpoint] = [each.subscription for each in connections]
            ends += [publication for publication, _ in staying]
            if (
                any(end in moving for end in ends)
                or any(each.subscription.connection is not each for each in connections)
                or any(publication.topic != topic for publication, topic in staying)
            ):
                return None
            for each in connections:
                each.subscription.connection = None
                self._unlink(each, discard=False)
        return [each.outside for each in connections if each.outside is not None]

    def renew(self, connection: Connection) -> None:
        """Renew the registration of a connection that was drained, but is not left."""
        with self._lock:
            old = connection.outside
            if connection.subscription.connection is not connection or old is None:
                return
        old.close()
        registration = self._subscribe(connection)
        with self._lock:
            current = connection.subscription.connection is connection
            current = current and connection.outside is old
            if current:
                connection.outside = registration
        if not current:
            registration.close()

    def park(
        self,
        links: Sequence[ParkedConnection],
        publications: Sequence[tuple[Publication, str]],
        patience: float,
    ) -> list[str]:
        """Hold connections, and registrations of publications, for a nodelet that is to come.

        When a subscription of the same owner and type is connected to the topic of a connection,
        it takes that over with all that has come; ``unpark`` withdraws the rest. Peers outside are
        waited for, ``patience`` seconds in all.

        Returns the addresses of publishers that do not send to this process yet; then nothing is
        parked. Raises what ``rewire`` raises.
        """
        parts = [_Part(link.subscription, link.topic, link) for link in links]
        parts += [_Part(publication, topic) for publication, topic in publications]
        for part in parts:
            if self._check_topic is not None:
                self._check_topic(part.topic)
        deadline = self._clock() + patience
        missing: list[str] = []
        try:
            with self._lock:
                for part in parts:
                    topic = self._topic(part.topic, part.endpoint.datatype)
                    if part.link is not None:
                        self._link(topic, part.link)
            for part in parts:
                self._register(part)
            for part in parts:
                seconds = max(0.0, deadline - self._clock())
                if part.link is None:
                    part.registration.wait(seconds)
                else:  # each publisher is waited for, also when the first has sent
                    part.link.outside = part.registration
                    part.registration.wait_for_all(seconds)
                    missing += part.registration.missing()
        except BaseException:
            self._undo(parts)
            raise
        if missing:
            self._undo(parts)
        else:
            with self._lock:
                self._parked += parts
        return missing

    def unpark(self, ends: Sequence[Endpoint]) -> None:
        """Withdraw those of parked subscriptions and publications that are not taken over."""
        with self._lock:
            left = [part for part in self._parked if part.endpoint in ends]
            self._parked = [part for part in self._parked if part not in left]
        self._undo(left)

    # The steps of a switch.

    def _make(self, parts: list[_Part], deadline: float, patience: float) -> None:
        with self._lock:
            left = {part.endpoint.topic for part in parts if part.is_publication}
            for part in parts:
                if not part.topic:
                    continue
                topic = self._topic(part.topic, part.endpoint.datatype)
                if part.is_publication:
                    part.is_live = bool(topic.route)
                    is_shared = any(map(_is_registered, topic.publications))
                    part.is_late = part.is_live and not is_shared
                    continue
                parked = self._claim(part)
                if parked is not None:
                    part.link, part.registration = parked.link, parked.registration
                    continue
                part.is_live = bool(topic.publications)
                is_shared = any(each.outside is not None for each in topic.route)
                part.is_late = part.is_live and not is_shared
                part.link = Connection(part.endpoint, part.topic)
                if part.topic not in left:  # else it would take messages from before the switch
                    self._link(topic, part.link)
            self._making += parts
        early = [p for p in parts if p.topic and not (p.is_late or p.registration)]
        for part in early:
            self._register(part)
            part.check_open()  # a concurrent release() may have missed this registration
        for part in early if patience else ():
            seconds = 0.0 if part.is_live else max(0.0, deadline - self._clock())
            if part.link is None:  # without a wait too: messages are kept for those to come
                part.registration.wait(seconds)
            elif seconds:
                part.registration.wait(part.link.arrived, seconds)

    def _drain(self, parts: list[_Part], patience: float) -> None:
        """Receive what old publishers outside have sent by now: it goes before the new."""
        with self._lock:
            self._check(parts)
        until = self._clock() + min(patience, _LONGEST_DRAIN_IN)
        for part in parts:
            connection = None if part.is_publication else part.endpoint.connection
            if patience and connection is not None and connection.outside is not None:
                part.drained = connection
                connection.outside.drain(until - self._clock())

    def _switch(self, parts: list[_Part], on_switch: Callable[[], None]) -> None:
        with self._lock:
            self._check(parts)
            come = {part.topic for part in parts if part.is_publication}
            for part in parts:
                part.old = part.endpoint.outside
                if not part.is_publication and part.endpoint.topic in come:
                    self._unlink(part.endpoint.connection, discard=False)
            for part in parts:
                if part.is_publication:
                    self._move(part)
            for part in parts:
                if not part.is_publication:
                    old, part.endpoint.connection = part.endpoint.connection, part.link
                    if part.link is not None:
                        part.link.outside = part.registration
                        topic = self._topic(part.topic, part.endpoint.datatype)
                        if part.link not in topic.route:
                            self._link(topic, part.link)
                    self._unlink(old, discard=False)
            on_switch()
            for part in parts:
                if part.link is not None:
                    part.link.open()
            self._making = [part for part in self._making if part not in parts]

    def _register_late(self, parts: list[_Part], patience: float) -> None:
        failures: list[BaseException] = []
        for part in parts:
            try:
                if part.is_late:
                    self._register(part)
                    if patience and part.is_publication:
                        part.registration.wait(0.0)  # messages are kept for those to come
            except BaseException as error:  # further parts are switched too and need theirs
                failures.append(error)
            self._put_in_place(part)
        if failures:
            raise failures[0]

    def _put_in_place(self, part: _Part) -> None:
        """Give an endpoint the registration that was made after its switch."""
        made, endpoint = part.registration, part.endpoint
        if part.is_publication and part.awaited is None and made is not None and endpoint.latch:
            part.awaited = self._before_latched(part)
        awaited = part.awaited
        if awaited is not None:
            self._pass_on(part, awaited)
        if made is None and awaited is None:
            return
        with self._lock:
            if part.link is not None:
                current = endpoint.connection is part.link
                part.link.outside = made
            else:
                current = endpoint.topic == part.topic and not endpoint.closed
                if current:
                    endpoint.set_outside(made)
        if made is None:
            return
        if not current and awaited is not None and awaited.drain(_RELEASE_DRAIN):
            self._leave_later(endpoint, made)  # moved on meanwhile, or released
        elif not current:
            made.close()

    def _before_latched(self, part: _Part) -> AwaitedPublisher | None:
        """Keep what a publication publishes from now on until its latched message is sent.

        None if it owes none: it has published since the switch, or left the topic.
        """
        endpoint = part.endpoint
        awaited = AwaitedPublisher(part.topic, None, latch=True, registration=part.registration)
        with self._lock:
            if endpoint.topic != part.topic or endpoint.closed:
                return None
            awaited.owed = endpoint.set_outside_unless_published(awaited, part.before)
        return None if awaited.owed is NOTHING else awaited

    def _pass_on(self, part: _Part, awaited: AwaitedPublisher) -> None:
        """Send what was published since the switch, if that is still allowed, and outside."""
        fence = self._fences.get(part.topic)
        made = part.registration
        if made is None or part.endpoint.closed or (fence and not fence(part.endpoint.owner)):
            awaited.close()
        if made is not None:
            awaited.pass_to(made)

    def _break(self, parts: list[_Part], deadline: float) -> None:
        for part in parts:
            left = max(0.0, deadline - self._clock())
            if isinstance(part.old, OutsidePublisher) and not part.old.drain(left):
                self._leave_later(part.endpoint, part.old)
            elif part.old is not None:
                part.old.close()

    def _leave_later(self, endpoint: Endpoint, registration: OutsidePublisher) -> None:
        """Withdraw a registration once a slow network has taken all that was published on it."""
        leaving = (endpoint, registration)
        with self._lock:
            is_released = endpoint.closed
            if not is_released:
                self._leaving.append(leaving)
        if is_released:
            registration.close()
            return

        def leave(seconds: float = _LONGEST_DRAIN) -> None:
            registration.drain(seconds)
            with self._lock:
                if leaving not in self._leaving:
                    return  # the endpoint was released, and this with it
                self._leaving.remove(leaving)
            registration.close()

        try:
            in_background("dyknow-drain", leave)
        except NO_THREAD as error:
            _log.warning("what is on the way from %s may be lost: %s", endpoint.owner, error)
            leave(0.0)

    def _undo(self, parts: list[_Part]) -> None:
        with self._lock:
            self._making = [part for part in self._making if part not in parts]
            for part in parts:
                self._unlink(part.link, discard=True)
            for part in parts:
                self._forget(part.topic)
        for part in parts:
            if part.registration is not None:
                part.registration.close()
            if part.drained is not None:
                self.renew(part.drained)

    def _register(self, part: _Part) -> None:
        end = part.endpoint
        if part.link is not None:
            part.registration = self._subscribe(part.link)
        else:
            part.registration = self._transport.advertise(
                part.topic, end.datatype, end.latch, end.queue_size, end.options
            )

    def _subscribe(self, connection: Connection) -> OutsideSubscriber:
        end = connection.subscription
        return self._transport.subscribe(
            connection.topic, end.datatype, connection.push, end.options
        )

    # The table; every method below is called with the lock held.

    def _check(self, parts: list[_Part]) -> None:
        for part in parts:
            part.check_open()
            if part.topic:
                self._topic(part.topic, part.endpoint.datatype)

    def _topic(self, name: str, datatype: Any) -> _Topic:
        topic = self._topics.get(name)
        if topic is None:
            topic = self._topics[name] = _Topic(datatype)
        elif topic.datatype._md5sum == "*":
            topic.datatype = datatype
        elif datatype._md5sum not in ("*", topic.datatype._md5sum):
            raise TypeMismatch(name, datatype._type, topic.datatype._type)
        return topic

    def _claim(self, part: _Part) -> _Part | None:
        """Take over a connection that is parked for the subscription of a part."""
        for parked in self._parked:
            link = parked.link
            if isinstance(link, ParkedConnection) and link.adopt(part.endpoint, part.topic):
                self._parked.remove(parked)
                return parked
        return None

    @staticmethod
    def _link(topic: _Topic, link: Connection) -> None:
        topic.route += (link,)
        for publication in topic.publications:
            publication.reroute(topic.route, newcomers=(link,))

    def _forget(self, name: str) -> None:
        # An end has left: the topic may be gone, or have only ends of any type now.
        topic = self._topics.get(name)
        if topic is None:
            return
        datatypes = [each.datatype for each in topic.publications]
        datatypes += [each.subscription.datatype for each in topic.route]
        if not datatypes:
            del self._topics[name]
        elif all(each._md5sum == "*" for each in datatypes):
            topic.datatype = datatypes[0]

    def _unlink(self, connection: Connection | None, discard: bool) -> None:
        if connection is None:
            return
        topic = self._topics.get(connection.topic)
        if topic is not None and connection in topic.route:
            topic.route = tuple(each for each in topic.route if each is not connection)
            for publication in topic.publications:
                publication.reroute(topic.route)
            self._forget(connection.topic)
        connection.close(discard)

    def _leave(self, publication: Publication) -> None:
        topic = self._topics.get(publication.topic)
        if topic is not None:
            topic.publications.remove(publication)
            self._forget(publication.topic)

    def _move(self, part: _Part) -> None:
        publication: Publication = part.endpoint
        if part.is_late:
            part.awaited = AwaitedPublisher(part.topic, publication.queue_size, publication.latch)
        self._leave(publication)
        route = None
        if part.topic:
            topic = self._topic(part.topic, publication.datatype)
            topic.publications.append(publication)
            route = topic.route
        fence = self._fences.get(part.topic)
        outside = part.registration or part.awaited
        part.before, owed = publication.connect(part.topic, outside, route, fence)
        if part.awaited is not None:
            part.awaited.owed = owed


def _is_registered(publication: Publication) -> bool:
    """Whether a publication has its registration."""
    outside = publication.outside
    return outside is not None and not isinstance(outside, AwaitedPublisher)
