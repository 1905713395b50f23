"""The in-process bus: which publications and connections meet on which topic.

The bus owns the table of topics and is the only one that changes it. All changes of the table
and of routes happen under its lock and touch memory only; everything that talks to ROS happens
before (make) or after (break), never under the lock.

A switch (``rewire``) goes through four steps:

1. make: new connections are linked, held, and where only the outside can feed or hear a topic,
   its registration is made and waited for;
2. switch: publications get their new route in one store each, old connections close, the marker
   goes into the strand, new connections open;
3. register: topics that are alive in this process switched at once; their registrations in ROS
   follow now;
4. break: what is left of the old topics is drained and withdrawn.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple, Union

from dyknow.errors import HandleClosed, TypeMismatch
from dyknow.locks import state_lock
from dyknow.nodelet.endpoints import NOTHING, Connection, Publication, Subscription
from dyknow.nodelet.middleware import OutsidePublisher, OutsideSubscriber, Transport
from dyknow.nodelet.scheduler import Clock

#: Seconds that a registration outlives a switch at most, while its messages are being sent.
_LONGEST_DRAIN = 30.0

Endpoint = Union[Publication, Subscription]
Move = Tuple[Endpoint, str]


@dataclass
class _Topic:
    """Who is on a topic in this process."""

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
    """One endpoint's part in a switch, filled in as the steps are taken."""

    endpoint: Endpoint
    topic: str
    link: Optional[Connection] = None
    half: Union[OutsidePublisher, OutsideSubscriber, None] = None
    late: bool = False
    old: Union[OutsidePublisher, OutsideSubscriber, None] = None


class Bus:
    """Delivers by reference between the endpoints of one process."""

    def __init__(self, transport: Transport, clock: Clock = time.monotonic) -> None:
        self._transport = transport
        self._clock = clock
        self._lock = state_lock("bus")
        self._topics: Dict[str, _Topic] = {}
        self._making: List[_Plan] = []
        self._leaving: List[Tuple[Endpoint, OutsidePublisher]] = []

    def datatype_of(self, topic: str) -> str:
        """Type name of a topic that is alive, in this process or outside; empty if it is not."""
        with self._lock:
            present = self._topics.get(topic)
            if present is not None and present.datatype._type != "*":
                return str(present.datatype._type)
        return self._transport.datatype_of(topic)

    def rewire(
        self,
        moves: Sequence[Move],
        between: Optional[Callable[[], None]] = None,
        patience: float = 0.0,
    ) -> None:
        """Connect every endpoint to its new topic (empty: to none), all in one switch.

        Args:
            moves: endpoint and global topic name; endpoints that are there already stay untouched.
            between: called at the switch, after the last old and before the first new message
                can be queued; it must only queue something.
            patience: seconds to wait, in all, for peers outside.

        Raises:
            TypeMismatch: a topic has another type in this process; nothing was changed.
            HandleClosed: an endpoint was released meanwhile; nothing was changed.
            Exception: a registration failed; nothing was changed, unless ``between`` was called.
        """
        plans = [_Plan(endpoint, topic) for endpoint, topic in moves if endpoint.topic != topic]
        deadline = self._clock() + patience
        try:
            self._make(plans, deadline)
            self._switch(plans, between)
        except BaseException:
            self._undo(plans)
            raise
        try:
            self._register(plans)
        finally:
            self._break(plans, deadline)

    def release(self, endpoints: Sequence[Endpoint]) -> None:
        """Take endpoints off the bus for good: queued messages are dropped, registrations end."""
        halves: List[Union[OutsidePublisher, OutsideSubscriber, None]] = []
        with self._lock:
            halves += [plan.half for plan in self._making if plan.endpoint in endpoints]
            halves += [half for endpoint, half in self._leaving if endpoint in endpoints]
            self._leaving = [each for each in self._leaving if each[0] not in endpoints]
            for endpoint in endpoints:
                if isinstance(endpoint, Publication):
                    halves.append(endpoint.outside)
                    self._leave(endpoint)
                    endpoint.disconnect(closed=True)
                else:
                    endpoint.closed = True
                    connection, endpoint.connection = endpoint.connection, None
                    if connection is not None:
                        halves.append(connection.outside)
                        self._unlink(connection, discard=True)
        for half in halves:
            if half is not None:
                half.close()

    # The four steps of a switch.

    def _make(self, plans: List[_Plan], deadline: float) -> None:
        with self._lock:
            for plan in plans:
                if not plan.topic:
                    continue
                topic = self._topic(plan.topic, plan.endpoint.datatype)
                if isinstance(plan.endpoint, Subscription):
                    plan.late = bool(topic.publications)
                    plan.link = Connection(plan.endpoint, plan.topic)
                    self._link(topic, plan.link)
                else:
                    plan.late = bool(topic.connections)
            self._making += plans
        early = [plan for plan in plans if plan.topic and not plan.late]
        for plan in early:
            plan.half = self._registration(plan)
            self._check_open(plan)  # who released it before did not know of this registration
        for plan in early:
            seconds = max(0.0, deadline - self._clock())
            if seconds and isinstance(plan.half, OutsidePublisher):
                plan.half.wait(seconds)
            elif seconds and isinstance(plan.half, OutsideSubscriber) and plan.link is not None:
                plan.half.wait(plan.link.arrived, seconds)

    def _switch(self, plans: List[_Plan], between: Optional[Callable[[], None]]) -> None:
        with self._lock:
            for plan in plans:
                self._check_open(plan)
                if plan.topic:
                    self._topic(plan.topic, plan.endpoint.datatype)
            for plan in plans:
                if isinstance(plan.endpoint, Publication):
                    self._move(plan, plan.endpoint)
            for plan in plans:
                if isinstance(plan.endpoint, Subscription):
                    old, plan.endpoint.connection = plan.endpoint.connection, plan.link
                    if plan.link is not None and isinstance(plan.half, OutsideSubscriber):
                        plan.link.outside = plan.half
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
                if plan.late:
                    plan.half = self._registration(plan)
            except BaseException as error:  # the others are switched too and need theirs
                failures.append(error)
            half, endpoint = plan.half, plan.endpoint
            owed = NOTHING
            with self._lock:
                if isinstance(endpoint, Publication):
                    current = endpoint.topic == plan.topic and not endpoint.closed
                    if current and isinstance(half, OutsidePublisher):
                        owed = endpoint.attend(half)
                else:
                    current = endpoint.connection is plan.link
                    if plan.link is not None and isinstance(half, OutsideSubscriber):
                        plan.link.outside = half
            if half is not None and not current:  # released or moved on meanwhile
                half.close()
            elif isinstance(endpoint, Publication) and isinstance(half, OutsidePublisher):
                while owed is not NOTHING:
                    half.latch(owed)
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

    def _leave_later(self, endpoint: Endpoint, half: OutsidePublisher) -> None:
        """Withdraw a registration once a slow network has taken what was published there."""
        leaving = (endpoint, half)
        with self._lock:
            self._leaving.append(leaving)

        def leave() -> None:
            half.drain(_LONGEST_DRAIN)
            with self._lock:
                if leaving not in self._leaving:
                    return  # the endpoint was released, and this with it
                self._leaving.remove(leaving)
            half.close()

        threading.Thread(target=leave, name="dyknow-drain", daemon=True).start()

    def _undo(self, plans: List[_Plan]) -> None:
        with self._lock:
            self._made(plans)
            for plan in plans:
                if plan.link is not None:
                    self._unlink(plan.link, discard=True)
            for plan in plans:
                self._forget(plan.topic)
        for plan in plans:
            if plan.half is not None:
                plan.half.close()

    @staticmethod
    def _check_open(plan: _Plan) -> None:
        if plan.endpoint.closed:
            raise HandleClosed(f"an endpoint of topic '{plan.topic}'")

    # The table; every method below is called with the lock held, except ``_registration``.

    def _made(self, plans: List[_Plan]) -> None:
        self._making = [plan for plan in self._making if plan not in plans]

    def _registration(self, plan: _Plan) -> Union[OutsidePublisher, OutsideSubscriber]:
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
        # Somebody left: the topic may be gone, or only ends of any type be left on it.
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
        half = plan.half if isinstance(plan.half, OutsidePublisher) else None
        publication.connect(plan.topic, half, topic.route)
