# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The in-process bus: which publications and connections meet on which topic.

The bus owns the table of topics; nothing else changes it. The table and the routes change under
the lock of the bus, in memory only. Everything that talks to ROS happens before (make) or after
(break) that, without the lock.

A switch (``rewire``) goes through four steps:

1. make: new connections are linked, held. Where a topic has no other end in this process, its
   registration is made now, and its peers outside are waited for;
2. switch: publications get their new route in one store each, old connections close, the marker
   goes into the strand, new connections open;
3. register: topics with other ends in this process have switched already; their registrations
   are made now;
4. break: the registrations of the old topics are drained and withdrawn.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple, Union

from dyknow.errors import HandleClosed, TypeMismatch
from dyknow.locks import state_lock
from dyknow.nodelet.endpoints import NOTHING, Connection, Publication, Subscription
from dyknow.nodelet.middleware import OutsidePublisher, OutsideSubscriber, Transport
from dyknow.nodelet.scheduler import Clock
from dyknow.periodic import in_background

#: Seconds that the registration of an old topic stays at most while its messages are being sent.
_LONGEST_DRAIN = 30.0
#: Seconds for sending what endpoints have published before they go for good.
_LAST_WORDS = 0.2
#: Seconds in which nobody waits for that any more: somebody does not read.
_NO_WORDS = 2.0
#: Seconds for receiving what old publishers have sent; it has come to this machine already.
_LONGEST_DRAIN_IN = 0.1

Endpoint = Union[Publication, Subscription]
Registration = Union[OutsidePublisher, OutsideSubscriber]
Move = Tuple[Endpoint, str]


@dataclass
class _Topic:
    """The ends of a topic in this process."""

    datatype: Any
    publications: List[Publication] = field(default_factory=list)
    connections: List[Connection] = field(default_factory=list)

    @property
    def ends(self) -> List[Union[Publication, Connection]]:
        return [*self.publications, *self.connections]

    @property
    def route(self) -> Tuple[Connection, ...]:
        return tuple(self.connections)


@dataclass(eq=False)
class _Plan:
    """One endpoint's part in a switch, filled in as the steps are taken.

    Attributes:
        endpoint: what moves.
        topic: where to; empty for nowhere.
        link: the new connection of a subscription.
        registration: on the new topic.
        register_after: whether that is made after the switch.
        drained: the connection that receives no more from outside, until the switch.
        old: registration on the topic that the endpoint leaves.
    """

    endpoint: Endpoint
    topic: str
    link: Optional[Connection] = None
    registration: Optional[Registration] = None
    register_after: bool = False
    drained: Optional[Connection] = None
    old: Optional[Registration] = None


class Bus:
    """Delivers by reference between the endpoints of one process."""

    def __init__(
        self,
        transport: Transport,
        clock: Clock = time.monotonic,
        check_topic: Optional[Callable[[str], None]] = None,
    ) -> None:
        """Begin without topics.

        Args:
            transport: the outside.
            clock: steady time.
            check_topic: raises Denied if nothing must be connected to a topic. It is called for
                every endpoint of the process, whatever connects it.
        """
        self._transport = transport
        self._check_topic = check_topic
        self._clock = clock
        self._lock = state_lock("bus")
        self._topics: Dict[str, _Topic] = {}
        self._making: List[_Plan] = []
        self._leaving: List[Tuple[Endpoint, OutsidePublisher]] = []
        self._patient_from = clock()
        self._fences: Mapping[str, Callable[[str], bool]] = {}

    def datatype_of(self, topic: str) -> str:
        """Type name of a topic that is alive, in this process or outside; empty if it is not."""
        with self._lock:
            present = self._topics.get(topic)
            if present is not None and present.datatype._type != "*":
                return str(present.datatype._type)
        return self._transport.datatype_of(topic)

    def owners(self, topic: str) -> Tuple[List[str], List[str]]:
        """Nodelets of this process that publish on a topic, and those that subscribe to it."""
        with self._lock:
            present = self._topics.get(topic)
            if present is None:
                return [], []
            publishers = {each.owner for each in present.publications}
            return sorted(publishers), sorted({each.owner for each in present.connections})

    def fence(self, fences: Mapping[str, Callable[[str], bool]]) -> None:
        """Ask before each message on these topics whether its nodelet may publish it now.

        Args:
            fences: by topic, a function of the nodelet's name that must be quick. Other topics
                are open to all.
        """
        with self._lock:
            self._fences = fences
            for name, topic in self._topics.items():
                for publication in topic.publications:
                    publication.set_fence(fences.get(name))

    def rewire(
        self,
        moves: Sequence[Move],
        between: Optional[Callable[[], None]] = None,
        patience: float = 0.0,
    ) -> None:
        """Connect every endpoint to its new topic (empty: to none), all in one switch.

        Args:
            moves: endpoint and global topic name; an endpoint that is on its topic already
                stays untouched.
            between: called at the switch, after the last old and before the first new message
                can be queued. The lock of the bus is held: it may only queue something.
            patience: seconds to wait, in all, for peers outside.

        Raises:
            Denied: a guard forbids a topic; nothing was changed.
            TypeMismatch: a topic has another type in this process; nothing was changed.
            HandleClosed: an endpoint was released meanwhile; nothing was changed.
            Exception: a registration failed; nothing was changed, unless ``between`` was called.
        """
        plans = [_Plan(endpoint, topic) for endpoint, topic in moves if endpoint.topic != topic]
        for plan in plans:
            if plan.topic and self._check_topic is not None:
                self._check_topic(plan.topic)
        deadline = self._clock() + patience
        try:
            self._make(plans, deadline)
            self._drain(plans, patience)
            self._switch(plans, between)
        except BaseException:
            self._undo(plans)
            raise
        try:
            self._register(plans)
        finally:
            self._break(plans, deadline)

    def release(self, endpoints: Sequence[Endpoint]) -> None:
        """Take endpoints off the bus for good: messages that wait for them are dropped.

        What they have published is sent first, as far as the network takes it soon.
        """
        made: List[Optional[Registration]] = []
        with self._lock:
            made += [plan.registration for plan in self._making if plan.endpoint in endpoints]
            made += [old for endpoint, old in self._leaving if endpoint in endpoints]
            self._leaving = [each for each in self._leaving if each[0] not in endpoints]
            for endpoint in endpoints:
                if isinstance(endpoint, Publication):
                    made.append(endpoint.outside)
                    self._leave(endpoint)
                    endpoint.disconnect(closed=True)
                else:
                    endpoint.closed = True
                    connection, endpoint.connection = endpoint.connection, None
                    if connection is not None:
                        made.append(connection.outside)
                        self._unlink(connection, discard=True)
        now = self._clock()
        deadline = now + _LAST_WORDS if now >= self._patient_from else now
        for registration in made:
            if isinstance(registration, OutsidePublisher):
                left = max(0.0, deadline - self._clock())
                if not registration.drain(left) and left:
                    self._patient_from = self._clock() + _NO_WORDS
            if registration is not None:
                registration.close()

    # The five steps of a switch.

    def _make(self, plans: List[_Plan], deadline: float) -> None:
        with self._lock:
            for plan in plans:
                if not plan.topic:
                    continue
                topic = self._topic(plan.topic, plan.endpoint.datatype)
                if isinstance(plan.endpoint, Subscription):
                    plan.register_after = bool(topic.publications)
                    plan.link = Connection(plan.endpoint, plan.topic)
                    self._link(topic, plan.link)
                else:
                    plan.register_after = bool(topic.connections)
            self._making += plans
        early = [plan for plan in plans if plan.topic and not plan.register_after]
        for plan in early:
            plan.registration = self._make_registration(plan)
            self._check_open(plan)  # a release before this did not know of the registration
        for plan in early:
            registration, seconds = plan.registration, max(0.0, deadline - self._clock())
            if seconds and isinstance(registration, OutsidePublisher):
                registration.wait(seconds)
            elif seconds and isinstance(registration, OutsideSubscriber) and plan.link is not None:
                registration.wait(plan.link.arrived, seconds)

    def _drain(self, plans: List[_Plan], patience: float) -> None:
        """Receive what old publishers outside have sent by now: it goes before the new."""
        with self._lock:
            self._check(plans)
        until = self._clock() + min(patience, _LONGEST_DRAIN_IN)
        for plan in plans:
            endpoint = plan.endpoint
            connection = endpoint.connection if isinstance(endpoint, Subscription) else None
            if patience and connection is not None and connection.outside is not None:
                plan.drained = connection
                connection.outside.drain(until - self._clock())

    def _switch(self, plans: List[_Plan], between: Optional[Callable[[], None]]) -> None:
        with self._lock:
            self._check(plans)
            for plan in plans:
                if isinstance(plan.endpoint, Publication):
                    self._move(plan, plan.endpoint)
            for plan in plans:
                if isinstance(plan.endpoint, Subscription):
                    old, plan.endpoint.connection = plan.endpoint.connection, plan.link
                    if plan.link is not None and isinstance(plan.registration, OutsideSubscriber):
                        plan.link.outside = plan.registration
                    if old is not None:
                        plan.old = old.outside
                        self._unlink(old, discard=False)
            if between is not None:
                between()
            for plan in plans:
                if plan.link is not None:
                    plan.link.open()
            self._made(plans)

    def _register(self, plans: List[_Plan]) -> None:
        failures: List[BaseException] = []
        for plan in plans:
            try:
                if plan.register_after:
                    plan.registration = self._make_registration(plan)
            except BaseException as error:  # the others are switched too and need theirs
                failures.append(error)
            registration, endpoint = plan.registration, plan.endpoint
            owed = NOTHING
            with self._lock:
                if isinstance(endpoint, Publication):
                    current = endpoint.topic == plan.topic and not endpoint.closed
                    if current and isinstance(registration, OutsidePublisher):
                        owed = endpoint.set_outside(registration)
                else:
                    current = endpoint.connection is plan.link
                    if plan.link is not None and isinstance(registration, OutsideSubscriber):
                        plan.link.outside = registration
            if registration is not None and not current:  # released or moved on meanwhile
                registration.close()
            elif isinstance(endpoint, Publication) and isinstance(registration, OutsidePublisher):
                while owed is not NOTHING:
                    registration.latch(owed)
                    # What was published meanwhile may have overtaken it: the last is to stay.
                    owed = NOTHING if endpoint.latched is owed else endpoint.latched
        if failures:
            raise failures[0]

    def _break(self, plans: List[_Plan], deadline: float) -> None:
        for plan in plans:
            left = max(0.0, deadline - self._clock())
            if isinstance(plan.old, OutsidePublisher) and not plan.old.drain(left):
                self._leave_later(plan.endpoint, plan.old)
            elif plan.old is not None:
                plan.old.close()

    def _leave_later(self, endpoint: Endpoint, registration: OutsidePublisher) -> None:
        """Withdraw a registration once a slow network has taken all that was published on it."""
        leaving = (endpoint, registration)
        with self._lock:
            self._leaving.append(leaving)

        def leave() -> None:
            registration.drain(_LONGEST_DRAIN)
            with self._lock:
                if leaving not in self._leaving:
                    return  # the endpoint was released, and this with it
                self._leaving.remove(leaving)
            registration.close()

        in_background("dyknow-drain", leave)

    def _undo(self, plans: List[_Plan]) -> None:
        with self._lock:
            self._made(plans)
            for plan in plans:
                if plan.link is not None:
                    self._unlink(plan.link, discard=True)
            for plan in plans:
                self._forget(plan.topic)
        for plan in plans:
            if plan.registration is not None:
                plan.registration.close()
            if plan.drained is not None:
                self._subscribe_again(plan.endpoint, plan.drained)

    def _subscribe_again(self, endpoint: Endpoint, connection: Connection) -> None:
        """Renew the registration of a connection that was drained, but is not left."""
        with self._lock:
            old = connection.outside
            if endpoint.closed or old is None:
                return
        old.close()
        registration = self._transport.subscribe(
            connection.topic, endpoint.datatype, connection.push, endpoint.options
        )
        with self._lock:
            current = not endpoint.closed
            if current:
                connection.outside = registration
        if not current:
            registration.close()

    @staticmethod
    def _check_open(plan: _Plan) -> None:
        if plan.endpoint.closed:
            raise HandleClosed(f"an endpoint of topic '{plan.topic}'")

    # The table; every method below is called with the lock held, except ``_make_registration``.

    def _check(self, plans: List[_Plan]) -> None:
        for plan in plans:
            self._check_open(plan)
            if plan.topic:
                self._topic(plan.topic, plan.endpoint.datatype)

    def _made(self, plans: List[_Plan]) -> None:
        self._making = [plan for plan in self._making if plan not in plans]

    def _make_registration(self, plan: _Plan) -> Registration:
        endpoint = plan.endpoint
        if isinstance(endpoint, Publication):
            return self._transport.advertise(
                plan.topic,
                endpoint.datatype,
                endpoint.latch,
                endpoint.queue_size,
                endpoint.options,
            )
        assert plan.link is not None
        return self._transport.subscribe(
            plan.topic, endpoint.datatype, plan.link.push, endpoint.options
        )

    def _topic(self, name: str, datatype: Any) -> _Topic:
        topic = self._topics.get(name)
        if topic is None:
            topic = self._topics[name] = _Topic(datatype)
        elif topic.datatype._md5sum == "*":
            topic.datatype = datatype
        elif datatype._md5sum not in ("*", topic.datatype._md5sum):
            raise TypeMismatch(name, datatype._type, topic.datatype._type)
        return topic

    def _forget(self, name: str) -> None:
        # An end has left: the topic may be gone, or have only ends of any type now.
        topic = self._topics.get(name)
        if topic is None:
            return
        ends = topic.ends
        if not ends:
            del self._topics[name]
        elif all(end.datatype._md5sum == "*" for end in ends):
            topic.datatype = ends[0].datatype

    def _link(self, topic: _Topic, connection: Connection) -> None:
        topic.connections.append(connection)
        for publication in topic.publications:
            publication.reroute(topic.route, newcomers=(connection,))

    def _unlink(self, connection: Connection, discard: bool) -> None:
        topic = self._topics.get(connection.topic)
        if topic is not None and connection in topic.connections:
            topic.connections.remove(connection)
            for publication in topic.publications:
                publication.reroute(topic.route)
            self._forget(connection.topic)
        connection.close(discard)

    def _leave(self, publication: Publication) -> None:
        topic = self._topics.get(publication.topic)
        if topic is not None:
            topic.publications.remove(publication)
            self._forget(publication.topic)

    def _move(self, plan: _Plan, publication: Publication) -> None:
        plan.old = publication.outside
        self._leave(publication)
        if not plan.topic:
            publication.disconnect()
            return
        topic = self._topic(plan.topic, publication.datatype)
        topic.publications.append(publication)
        made = plan.registration
        outside = made if isinstance(made, OutsidePublisher) else None
        publication.connect(plan.topic, outside, topic.route, self._fences.get(plan.topic))
