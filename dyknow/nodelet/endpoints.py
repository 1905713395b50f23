# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The two ends of a stream inside the process, and the link between them.

A ``Publication`` hands each message, by reference, to the ``Connection`` of every subscription
of its topic. A connection is one subscription's link to one topic and has the queue of what it
has yet to deliver. When a subscription moves to another topic it gets a new connection: the old
one takes no more but still delivers what it holds, and all of that stands in the nodelet's strand
before anything of the new one.

Who owns what: the bus makes and links these objects; ports and handles hold them.
"""

from __future__ import annotations

import collections
import threading
from typing import Any, Callable, Deque, Dict, List, Optional, Sequence, Tuple

from dyknow.nodelet.locking import message_lock
from dyknow.nodelet.middleware import (
    HERE,
    OutsidePublisher,
    OutsideSubscriber,
    Receive,
)
from dyknow.nodelet.scheduler import Clock, Strand
from dyknow.nodelet.traffic import Traffic

#: Stands for "no message", since a message may be None.
NOTHING: Any = object()

Callback = Tuple[Callable[..., Any], Tuple[Any, ...]]
"""A callback of a user, and its arguments after the message."""

_attempt, _wait, _leave = message_lock.attempt, message_lock.wait, message_lock.leave

_HELD, _OPEN, _CLOSED = "held", "open", "closed"


class Connection:
    """One subscription's link to one topic.

    Held, it collects messages; open, it delivers them on the strand; closed, it takes no more.
    It is itself the task that delivers its oldest message: nothing else is touched on the way.
    """

    __slots__ = (
        "_arrived",
        "_limit",
        "_queue",
        "_state",
        "_strand",
        "_subscription",
        "outside",
        "topic",
    )

    def __init__(self, subscription: Subscription, topic: str) -> None:
        self.topic = topic
        self.outside: Optional[OutsideSubscriber] = None
        self._subscription = subscription
        self._limit = subscription.queue_size or -1
        self._queue: Deque[Any] = collections.deque()
        self._state = _HELD
        self._strand = subscription.strand
        self._arrived: Optional[threading.Event] = None

    @property
    def datatype(self) -> Any:
        """Message class of the subscription."""
        return self._subscription.datatype

    @property
    def owner(self) -> str:
        """Name of the nodelet."""
        return self._subscription.owner

    def push(self, message: Any) -> None:
        """Take a message, from any thread; beyond ``queue_size`` the oldest goes, counted."""
        with message_lock:
            self.push_locked(message)

    def push_locked(self, message: Any) -> None:
        """Same, with the lock held."""
        if self._state is _CLOSED:
            return
        queue = self._queue
        queue.append(message)
        if len(queue) - 1 == self._limit:
            queue.popleft()
            self._subscription.traffic.dropped += 1
        elif self._state is _OPEN:
            self._strand.post_locked(self)
        elif self._arrived is not None:
            self._arrived.set()

    def __call__(self) -> None:
        """Deliver the oldest message, if there is one."""
        try:  # without the lock: a push keeps queued messages == queued tasks
            message = self._queue.popleft()
        except IndexError:
            return
        subscription = self._subscription
        clock = subscription.clock
        start = clock()
        try:
            subscription.receive(message)
        except BaseException as error:  # the boundary: a callback never takes its neighbours down
            subscription.failed(error)
        subscription.traffic.received(start, clock() - start)

    def arrived(self, seconds: float) -> bool:
        """Wait for the first message of a held connection."""
        with message_lock:
            if self._queue:
                return True
            if self._arrived is None:
                self._arrived = threading.Event()
        return self._arrived.wait(seconds)

    def open(self) -> None:
        """Deliver what was held, and everything from now on."""
        with message_lock:
            if self._state is _HELD:
                self._state = _OPEN
                for _ in self._queue:
                    self._strand.post_locked(self)

    def close(self, discard: bool) -> None:
        """Take no more; what is queued is still delivered unless it is to be discarded."""
        with message_lock:
            self._state = _CLOSED
            if discard:
                self._queue.clear()


class Subscription:
    """A callback with a queue on a strand, connected to one topic or to none."""

    __slots__ = (
        "callbacks",
        "clock",
        "closed",
        "connection",
        "datatype",
        "failed",
        "options",
        "owner",
        "queue_size",
        "receive",
        "strand",
        "traffic",
    )

    def __init__(
        self,
        datatype: Any,
        receive: Receive,
        queue_size: Optional[int],
        strand: Strand,
        failed: Callable[[BaseException], None],
        clock: Clock,
        options: Optional[Dict[str, Any]] = None,
    ) -> None:
        """Describe a subscription.

        Args:
            datatype: message class.
            receive: called with each message, on the strand.
            queue_size: messages that wait at most; None or 0 for no bound, as in rospy.
            strand: where ``receive`` is run.
            failed: called with what ``receive`` raises.
            clock: steady seconds, for the statistics.
            options: further arguments for the registration outside.
        """
        self.datatype = datatype
        self.receive = receive
        self.queue_size = queue_size
        self.strand = strand
        self.failed = failed
        self.clock = clock
        self.options = options or {}
        #: What ``spread`` calls.
        self.callbacks: Tuple[Callback, ...] = ()
        #: Name of the nodelet.
        self.owner = ""
        self.traffic = Traffic(clock)
        self.connection: Optional[Connection] = None
        self.closed = False

    @property
    def topic(self) -> str:
        """Global name of the connected topic, empty when disconnected."""
        return self.connection.topic if self.connection is not None else ""

    def spread(self, message: Any) -> None:
        """Call every one of ``callbacks``."""
        errors: List[BaseException] = []
        for callback, args in self.callbacks:
            try:
                callback(message, *args)
            except BaseException as error:  # the boundary, for each callback by itself
                errors.append(error)
        while errors:
            self.failed(errors.pop(0))

    def let_go(self) -> None:
        """Drop the callbacks after the release: they refer to the nodelet, and it to this."""
        self.receive, self.callbacks = _ignore, ()


class Publication:
    """What a nodelet publishes through: connected to one topic or to none.

    ``publish`` looks at the route once, so a message goes wholly where the publication was
    connected at that moment.
    """

    __slots__ = (
        "_age",
        "_age_of",
        "_build",
        "_closed",
        "_fence",
        "_is_age_wanted",
        "_keeps",
        "_outside",
        "_route",
        "_watchers",
        "datatype",
        "latch",
        "latched",
        "options",
        "owner",
        "queue_size",
        "refusal",
        "topic",
        "traffic",
    )

    def __init__(
        self,
        datatype: Any,
        latch: bool,
        queue_size: Optional[int],
        build: Callable[[Any, Sequence[Any], Dict[str, Any]], Any],
        clock: Clock,
        refusal: Callable[[], Exception],
        options: Optional[Dict[str, Any]] = None,
        age_of: Callable[[Any], Optional[float]] = lambda message: None,
    ) -> None:
        """Describe a publication.

        Args:
            datatype: message class.
            latch: keep the last message for subscriptions that come later.
            queue_size: bound for each slow subscriber outside.
            build: makes a message from its class and fields, as ``Transport.build``.
            clock: steady seconds, for the statistics.
            refusal: makes the exception that a publish raises after the end.
            options: further arguments for the registration outside.
            age_of: tells the age of a message in seconds, as ``Transport.age_of``.
        """
        self.datatype = datatype
        self.latch = latch
        self.queue_size = queue_size
        self.options = options or {}
        #: Name of the nodelet.
        self.owner = ""
        self.topic = ""
        self.traffic = Traffic(clock)
        self.latched = NOTHING
        self._build = build
        self._age_of = age_of
        self._age: Optional[float] = None
        self._is_age_wanted = False
        self._fence: Optional[Callable[[str], bool]] = None
        #: Whether a message is looked at when it is published: this is all that it costs others.
        self._keeps = latch
        self.refusal = refusal
        self._route: Optional[Tuple[Connection, ...]] = None
        self._outside: Optional[OutsidePublisher] = None
        self._closed = False
        self._watchers: Tuple[Callable[[], None], ...] = ()

    def publish(self, message: Any = NOTHING, /, *fields: Any, **named: Any) -> None:
        """Publish a message, or the message made of the given fields, as in rospy.

        Raises:
            HandleClosed: the publication was unregistered or its nodelet unloaded (in ROS, a
                ``rospy.ROSException``).
        """
        if message.__class__ is not self.datatype or fields or named:
            if message is not NOTHING:
                fields = (message, *fields)
            message = self._build(self.datatype, fields, named)
        if not _attempt(False):
            _wait()
        try:
            if self._route is None:
                self._unrouted(message)
                return
            if self._keeps and not self._keep(message):
                return
            self.traffic.sent()
            for connection in self._route:
                connection.push_locked(message)
            outside = self._outside
            if outside is None or not (self.latch or outside.heard):
                return
            outside.in_flight += 1
        finally:
            _leave()
        _hand_over(outside, outside.latch if self.latch else outside.publish, message)

    def publish_to(self, topic: str, peer: Any, message: Any) -> None:
        """Send a message to one of the ``peers`` of a topic, uncounted; nothing if it has left."""
        with message_lock:
            if topic != self.topic or (self._fence and not self._fence(self.owner)):
                return
            if peer is HERE:
                for connection in self._route or ():
                    connection.push_locked(message)
            outside = self._outside
            if outside is None:
                return
            outside.in_flight += 1
        _hand_over(outside, outside.publish_to, peer, message)

    def _keep(self, message: Any) -> bool:
        """Note what is kept of a message; returns whether it may be sent."""
        if self._fence is not None and not self._fence(self.owner):
            self.traffic.dropped += 1
            return False
        if self.latch:
            self.latched = message
        if self._is_age_wanted:
            self._is_age_wanted, self._keeps = False, self.latch or self._fence is not None
            self._age = self._age_of(message)
        return True

    def set_fence(self, fence: Optional[Callable[[str], bool]]) -> None:
        """Ask ``fence`` with each message whether our nodelet may publish on its topic now."""
        with message_lock:
            self._fence = fence
            self._keeps = self.latch or self._is_age_wanted or fence is not None

    def sample_age(self) -> Optional[float]:
        """Return how old a message was when it was published, and let the next one be measured.

        Returns:
            Seconds, of the first message after the last question; None if that is not known.
        """
        with message_lock:
            self._is_age_wanted = self._keeps = True
            return self._age

    def _unrouted(self, message: Any) -> None:
        if self._closed:
            raise self.refusal()
        self.traffic.dropped += 1
        if self.latch:
            self.latched = message

    @property
    def outside(self) -> Optional[OutsidePublisher]:
        """The registration in ROS."""
        return self._outside

    @property
    def closed(self) -> bool:
        """Whether it was unregistered."""
        return self._closed

    def set_outside(self, outside: Optional[OutsidePublisher]) -> Any:
        """Publish through this registration too; returns the latched message that it is owed."""
        with message_lock:
            self._set_outside(outside)
            owed = self.latched
        self._changed()
        return owed

    def connect(
        self,
        topic: str,
        outside: Optional[OutsidePublisher],
        route: Tuple[Connection, ...],
        fence: Optional[Callable[[str], bool]] = None,
    ) -> None:
        """Publish on another topic from now on, to all of its connections."""
        self.set_fence(fence)
        with message_lock:
            self.topic = topic
            self._set_outside(outside)
            self._reroute(route, newcomers=route)
        self._changed()

    def reroute(
        self, route: Tuple[Connection, ...], newcomers: Tuple[Connection, ...] = ()
    ) -> None:
        """Publish to ``route`` from now on; ``newcomers`` get a latched message first."""
        with message_lock:
            self._reroute(route, newcomers)
        self._changed()

    def disconnect(self, closed: bool = False) -> None:
        """Publish to no topic; for good, if ``closed``."""
        with message_lock:
            self._route = None
            self._closed = self._closed or closed
            self._set_outside(None)
            self.topic = ""
        self._changed()

    def let_go(self) -> None:
        """Drop what is kept for listeners, after the release."""
        self.latched, self._watchers = NOTHING, ()

    def peers(self) -> Tuple[str, Tuple[Any, ...]]:
        """The topic and its listeners: one for each outside, ``HERE`` for all of this process."""
        with message_lock:
            topic, route, outside = self.topic, self._route, self._outside
        listening = outside.peers() if outside is not None else ()
        return topic, (listening if HERE in listening or not route else (HERE, *listening))

    def get_num_connections(self) -> int:
        """Count the peers; all of this process are one, as in roscpp."""
        return len(self.peers()[1])

    def watch(self, changed: Callable[[], None]) -> None:
        """Call ``changed``, which must be quick, whenever ``peers`` may have changed."""
        with message_lock:
            self._watchers = (*self._watchers, changed)

    def unwatch(self, changed: Callable[[], None]) -> None:
        """End the calls that ``watch`` began."""
        with message_lock:
            self._watchers = tuple(each for each in self._watchers if each != changed)

    def _changed(self) -> None:
        for changed in self._watchers:
            changed()

    # Under the lock:

    def _set_outside(self, outside: Optional[OutsidePublisher]) -> None:
        if self._outside is not None:
            self._outside.changed = None
        self._outside = outside
        if outside is not None:
            outside.changed = self._changed

    def _reroute(self, route: Tuple[Connection, ...], newcomers: Tuple[Connection, ...]) -> None:
        self._route = route
        if self.latched is not NOTHING:
            for connection in newcomers:
                connection.push_locked(self.latched)


def _ignore(message: Any) -> None:
    """Receive nothing."""


def _hand_over(outside: OutsidePublisher, send: Callable[..., None], *what: Any) -> None:
    """Send outside what was counted as in flight under the lock."""
    try:
        send(*what)
    finally:
        with message_lock:
            outside.in_flight -= 1
