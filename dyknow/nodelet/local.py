# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A middleware without ROS: everything stays in this process.

The public fake beside the real one: it runs nodelets in tests and wherever there is no roscore.
Its time is set by hand, its "outside" are lists that a test reads.
"""

from __future__ import annotations

import hashlib
import pickle
from dataclasses import dataclass, field
from typing import Any, Callable, Sequence

from dyknow.locks import assert_no_state_lock, state_condition
from dyknow.nodelet import middleware


@dataclass(frozen=True)
class LocalTimerEvent:
    """A timer event in seconds; the field names are rospy's."""

    last_expected: float | None
    last_real: float | None
    current_expected: float
    current_real: float
    last_duration: float | None


class ManualTicker(middleware.Ticker):
    """Time that stands still until ``advance``.

    The thread of the timers waits here. ``next_due`` returns only once that thread has fired
    the due timers and waits again, so a test never races with it.
    """

    def __init__(self) -> None:
        self._seconds = 0.0
        self._changed = state_condition("manual ticker")
        self._used = False  # there was a timer, so the thread runs
        self._waiting = False
        self._woken = False
        self._due: float | None = None

    def now(self) -> float:
        return self._seconds

    def advance(self, seconds: float) -> None:
        """Let time pass; negative seconds set it back, as simulated time may be."""
        self.set(self._seconds + seconds)

    def set(self, seconds: float) -> None:
        """Set the time; timers that are due by then fire on their thread."""
        with self._changed:
            if self._used and seconds != self._seconds:
                self._woken = True  # the thread has to see it, also where time goes back
            self._seconds = seconds
            self._changed.notify_all()

    def next_due(self, timeout: float = 10.0) -> float | None:
        """Wait until everything due was fired; return when the next timer is due, None for never.

        Raises:
            TimeoutError: the thread is still at work after ``timeout`` seconds.
        """
        with self._changed:
            if not self._changed.wait_for(self._is_settled, timeout):
                raise TimeoutError(f"the timers have not fired within {timeout:g} s")
            return self._due

    def wait(self, until: float | None) -> None:
        with self._changed:
            self._waiting, self._due = True, until
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._woken or self._is_due())
            self._waiting = self._woken = False

    def wake(self) -> None:
        with self._changed:
            self._used = self._woken = True
            self._changed.notify_all()

    def event(self, last: Any, expected: float, real: float, duration: Any) -> Any:
        return LocalTimerEvent(
            last and last.current_expected, last and last.current_real, expected, real, duration
        )

    def _is_due(self) -> bool:
        return self._due is not None and self._seconds >= self._due

    def _is_settled(self) -> bool:
        return not self._used or (self._waiting and not self._woken and not self._is_due())


class LocalPublisher(middleware.OutsidePublisher):
    """Calls the listeners of ``LocalTransport.listen``, and keeps no message for later ones."""

    def __init__(self, transport: LocalTransport, topic: str, datatype: Any) -> None:
        self.transport = transport
        self.topic = topic
        self.datatype = datatype
        self.connections: list[Callable[[Any], None]] = transport.listeners.setdefault(topic, [])
        self.in_flight = 0
        self.changed: Callable[[], None] | None = None
        transport.publishers.append(self)

    @property
    def heard(self) -> bool:
        return bool(self.connections)

    def peers(self) -> tuple[Any, ...]:
        return tuple(self.connections)

    def publish(self, message: Any) -> None:
        for listener in self.connections:
            listener(message)

    def publish_to(self, peer: Any, message: Any) -> None:
        if peer in self.connections:
            peer(message)

    def latch(self, message: Any) -> None:
        self.publish(message)

    def wait(self, seconds: float) -> None:
        """Return at once: listeners are there or not."""

    def drain(self, seconds: float) -> bool:
        return True

    def close(self) -> None:
        self.transport.withdraw(self.transport.publishers, self)


class LocalSubscriber(middleware.OutsideSubscriber):
    """Receives what ``LocalTransport.send`` sends."""

    def __init__(
        self, transport: LocalTransport, topic: str, datatype: Any, receive: middleware.Receive
    ) -> None:
        self.transport = transport
        self.topic = topic
        self.datatype = datatype
        self.receive = receive
        self.drained = False
        transport.subscribers.append(self)

    def publishers(self) -> int:
        return 0

    def wait(self, arrived: Callable[[float], bool], seconds: float) -> None:
        """Return at once: a publisher outside is known only when it sends."""

    def drain(self, seconds: float) -> None:
        self.drained = True

    def close(self) -> None:
        self.transport.withdraw(self.transport.subscribers, self)


class LocalTransport(middleware.Transport):
    """Topics of one process, and an outside that tests play."""

    def __init__(self) -> None:
        #: Subscribers outside, by topic.
        self.listeners: dict[str, list[Callable[[Any], None]]] = {}
        self.publishers: list[LocalPublisher] = []  # that are registered
        self.subscribers: list[LocalSubscriber] = []
        self.types: dict[str, str] = {}  # of topics that live outside
        #: By the value of a port's parameter ``image_transport``.
        self.codecs: dict[str, middleware.Codec] = {}

    @property
    def registrations(self) -> list[tuple[str, str]]:
        """Every registration that is not withdrawn, as (kind, topic), sorted."""
        made = [("publisher", each.topic) for each in self.publishers]
        return sorted([*made, *(("subscriber", each.topic) for each in self.subscribers)])

    def send(self, topic: str, message: Any) -> None:
        """Publish from outside."""
        for subscriber in list(self.subscribers):
            if subscriber.topic == topic and not subscriber.drained:
                subscriber.receive(message)

    def listen(self, topic: str, listener: Callable[[Any], None]) -> None:
        """Subscribe from outside."""
        self.listeners.setdefault(topic, []).append(listener)
        self._notify_publishers(topic)

    def stop_listening(self, topic: str, listener: Callable[[Any], None]) -> None:
        """End a subscription that ``listen`` made."""
        self.listeners[topic].remove(listener)
        self._notify_publishers(topic)

    def _notify_publishers(self, topic: str) -> None:
        for publisher in list(self.publishers):
            if publisher.topic == topic and publisher.changed is not None:
                publisher.changed()

    def withdraw(self, made: list[Any], registration: Any) -> None:
        """Remove a registration from the publishers or subscribers, if it is there."""
        assert_no_state_lock(f"withdrawing {registration.topic}")
        if registration in made:
            made.remove(registration)

    def advertise(self, topic: str, datatype: Any, *details: Any) -> LocalPublisher:
        assert_no_state_lock(f"advertising {topic}")
        return LocalPublisher(self, topic, datatype)

    def subscribe(
        self, topic: str, datatype: Any, receive: middleware.Receive, options: dict[str, Any]
    ) -> LocalSubscriber:
        assert_no_state_lock(f"subscribing to {topic}")
        return LocalSubscriber(self, topic, datatype, receive)

    def datatype_of(self, topic: str) -> str:
        assert_no_state_lock(f"asking for the type of {topic}")
        return self.types.get(topic, "")

    def is_published(self, topic: str) -> bool:
        return topic in self.types or any(each.topic == topic for each in self.publishers)

    def codec(self, datatype: Any, parameter: middleware.Parameter) -> middleware.Codec | None:
        return self.codecs.get(parameter("image_transport", "")) if self.codecs else None

    def digest(self, message: Any) -> bytes:
        return hashlib.blake2b(repr(message).encode(), digest_size=middleware.DIGEST_SIZE).digest()

    def pack(self, message: Any) -> bytes:
        return pickle.dumps(message)

    def unpack(self, datatype: Any, content: bytes) -> Any:
        return pickle.loads(content)

    def build(self, datatype: Any, args: Sequence[Any], kwds: dict[str, Any]) -> Any:
        """Make a message from its fields; one that is a message already passes."""
        if len(args) == 1 and not kwds and getattr(args[0], "_type", None) == datatype._type:
            return args[0]
        return datatype(*args, **kwds)


@dataclass
class LocalService(middleware.Closable):
    """One offered service."""

    handlers: dict[str, middleware.Handler]
    name: str
    handler: middleware.Handler

    def close(self) -> None:
        assert_no_state_lock(f"withdrawing {self.name}")
        if self.handlers.get(self.name) is self.handler:  # not that of a later one
            del self.handlers[self.name]


class LocalServices(middleware.Services):
    """Services that a test calls; ``handlers`` has them by global name."""

    def __init__(self) -> None:
        self.handlers: dict[str, middleware.Handler] = {}

    def call(self, service: str, request: Any) -> Any:
        """Call a service from outside."""
        return self.handlers[service](request)

    def offer(
        self,
        service: str,
        service_class: Any,
        handler: middleware.Handler,
        options: Any,
        owner: str,
    ) -> LocalService:
        assert_no_state_lock(f"offering {service}")
        self.handlers[service] = handler
        return LocalService(self.handlers, service, handler)


class LocalNode(middleware.Node):
    """A process that goes on."""

    def __init__(self) -> None:
        self.parameters: dict[str, Any] = {}  # of the parameter server
        self.remappings: dict[str, str] = {}  # of the command line, global names

    def is_shutdown(self) -> bool:
        return False

    def remap(self, name: str) -> str:
        return self.remappings.get(name, name)

    def member(self, name: str, handle: Any) -> Any:
        """Parameters, under rospy's names; nothing else."""
        parameters, resolve = self.parameters, handle.resolve_name
        members: dict[str, Callable[..., Any]] = {
            "get_param": lambda key, *default: parameters.get(resolve(key), *default),
            "set_param": lambda key, value: parameters.__setitem__(resolve(key), value),
            "has_param": lambda key: resolve(key) in parameters,
        }
        if name not in members:
            raise AttributeError(f"the local middleware has no '{name}'")
        return members[name]


@dataclass(frozen=True)
class LocalMiddleware(middleware.Middleware):
    """Everything that ROS would do, done with dictionaries."""

    transport: LocalTransport = field(default_factory=LocalTransport)
    services: LocalServices = field(default_factory=LocalServices)
    ticker: ManualTicker = field(default_factory=ManualTicker)
    node: LocalNode = field(default_factory=LocalNode)
