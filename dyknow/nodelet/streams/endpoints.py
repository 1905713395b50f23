# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The two ends of a stream inside the process, and the link between them.

A ``Publication`` hands each message, by reference, to the ``Connection`` of every subscription
of its topic. A connection is one subscription's link to one topic and has a queue of the messages
that it has yet to deliver. When a subscription moves to another topic it gets a new connection:
the old one takes no more but still delivers its queue, and all of that stands in the nodelet's
strand before anything of the new one.

Ownership: the bus makes and links these objects; ports and handles hold them.
"""

from __future__ import annotations

import collections
import threading
from typing import Any, Callable

from dyknow.nodelet.middleware import (
    HERE,
    Converter,
    OutsidePublisher,
    OutsideSubscriber,
    Receive,
    Transport,
)
from dyknow.nodelet.scheduler import Clock, Strand, message_lock

NOTHING: Any = object()  # stands for "no message", since a message may be None
#: A rate is taken over the last one to two stretches of so many messages, so that it follows.
_STRETCH = 32
#: Shorter silences are none; a longer one is if it is also longer than some messages took.
_PAUSE, _OVERDUE = 2.0, 3
#: Messages that are kept at most of a nodelet that is moved to another process, for each in-port.
MOST_KEPT = 1000
_HELD, _OPEN, _NOTED, _CLOSED = "held", "open", "noted", "closed"

_attempt, _wait, _leave = message_lock.attempt, message_lock.wait, message_lock.leave

Fence = Callable[[str], bool]
"""Returns whether a nodelet may publish on a topic now; called for each message."""


class Traffic:
    """Running counts of one end of a stream; written by one thread at a time.

    They are written for every message of every port, mostly with cold caches, so that touches as
    little memory as it can: no window of time stamps is kept, only where two stretches began.

    Attributes:
        messages: sent or received.
        dropped: refused by a full queue, or published while disconnected.
        busy: seconds that callbacks took.
        longest: seconds that the longest of them took.
        last: when the last message was published, or its callback began.
    """

    __slots__ = tuple("_before _begin _settled busy clock dropped last longest messages".split())

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.messages = self.dropped = 0
        self.last = self.busy = self.longest = self._settled = 0.0
        #: Number and time of the first message of this stretch and of the one before.
        self._begin = self._before = (0, 0.0)

    def received(self, start: float) -> None:
        """Count one message whose callback began at ``start`` and has just returned."""
        took = self.clock() - start
        self.messages = number = self.messages + 1
        self.busy += took
        if took > self.longest:
            self.longest = took
        if number % _STRETCH == 1 or start - self.last > _PAUSE:
            self.begin_stretch(number, start)
        self.last = start

    def begin_stretch(self, number: int, now: float) -> None:
        """Start a stretch with this message, if it is due or follows a pause."""
        if number == 1 or self._is_pause(number - 1, now):
            self._before = self._begin = (number, now)
        elif number % _STRETCH == 1:
            self._before, self._begin = self._begin, (number, now)

    @property
    def unsettled(self) -> float:
        """Seconds that callbacks took since ``settle``."""
        return self.busy - self._settled

    def settle(self) -> float:
        """Return what is unsettled, for the nodelet's sum: another end may continue the counts."""
        unsettled = self.unsettled
        self._settled += unsettled
        return unsettled

    def rate(self) -> float:
        """Return Hz over the last messages; 0 for less than two, and when none come any more."""
        number, now, (first, since) = self.messages, self.clock(), self._before
        intervals = number - first
        if intervals < 1 or first == 0 or self._is_pause(number, now):
            return 0.0
        span = self.last - since
        silence = now - self.last
        # Until one is overdue the rate is that of the stretch; then the silence counts with it.
        if silence > 2 * span / intervals:
            span += silence
        return intervals / span if span > 0 else 0.0

    def _is_pause(self, number: int, now: float) -> bool:
        """Whether message ``number`` came so long before ``now`` that the stream had stopped."""
        first, since = self._before
        silence = now - self.last
        return silence > _PAUSE and silence * (number - first) > _OVERDUE * (self.last - since)


class Connection:
    """One subscription's link to one topic.

    Held, it collects messages; open, it delivers them on the strand; noted, it delivers them and
    keeps a copy; closed, it takes no more. It is itself the task that delivers its
    oldest message: nothing else is touched on the way.
    """

    __slots__ = tuple(
        "_arrived _limit _noted _queue _state _strand outside subscription topic".split()
    )

    def __init__(self, subscription: Subscription, topic: str) -> None:
        self.topic = topic
        self.subscription = subscription
        self.outside: OutsideSubscriber | None = None
        self._limit = subscription.queue_size or -1
        self._queue: collections.deque[Any] = collections.deque()
        self._state = _HELD
        self._strand = subscription.strand
        self._arrived: threading.Event | None = None
        #: Messages that it was given while it is noted, each with its time.
        self._noted: collections.deque[tuple[float, Any]] = collections.deque(maxlen=MOST_KEPT)

    def push(self, message: Any) -> None:
        """Take a message, from any thread; beyond ``queue_size`` the oldest goes, counted."""
        with message_lock:
            self.push_locked(message)

    def push_locked(self, message: Any) -> None:
        state = self._state
        if state is not _OPEN:
            if state is _CLOSED:
                return
            if state is _NOTED:
                self._noted.append((self._strand.clock(), message))
        queue = self._queue
        queue.append(message)
        if len(queue) - 1 == self._limit:
            if queue.popleft() is not message or queue:
                self.subscription.traffic.dropped += 1
                return
            queue.append(message)  # a delivery has just taken the oldest
        if state is not _HELD:
            strand = self._strand
            if strand.alive:  # as post_locked, without its call
                strand._tasks.append(self)
                if not strand._busy:
                    strand._busy = True
                    strand._ready(strand)
        elif self._arrived is not None:
            self._arrived.set()

    def push_latched(self, message: Any) -> None:
        """Take the message that a publication latched before the two were connected."""
        self.push_locked(message)

    def __call__(self) -> None:
        """Deliver the oldest message, if there is one; the strand has just noted the time."""
        try:  # without the lock: a push keeps queued messages == queued tasks
            message = self._queue.popleft()
        except IndexError:
            return
        subscription = self.subscription
        try:
            subscription.receive(message)
        except BaseException as error:  # the boundary: a callback never takes its neighbours down
            subscription.failed(error)
        subscription.traffic.received(self._strand.began)  # type: ignore[arg-type]

    def arrived(self, seconds: float) -> bool:
        """Wait for the first message of a held connection."""
        with message_lock:
            if self._queue:
                return True
            if self._arrived is None:
                self._arrived = threading.Event()
        return self._arrived.wait(seconds)

    def open(self) -> None:
        """Deliver the held messages, and all further ones."""
        with message_lock:
            if self._state is _HELD:
                self._state = _OPEN
                for _ in self._queue:
                    self._strand.post_locked(self)

    def note(self, is_noted: bool) -> None:
        """Start or stop keeping the messages that an open connection receives."""
        with message_lock:
            if self._state in (_OPEN, _NOTED):
                self._noted.clear()
                self._state = _NOTED if is_noted else _OPEN

    def noted(self, after: float) -> list[tuple[float, Any]]:
        """Return the messages since ``note`` that came after a moment, each with its time."""
        with message_lock:
            return [each for each in self._noted if each[0] > after]

    def take(self) -> tuple[list[tuple[float, Any]], list[Any]]:
        """Return the messages since ``note``, and take those that are not delivered yet."""
        with message_lock:
            waiting = list(self._queue)
            self._queue.clear()
            return list(self._noted), waiting

    def close(self, discard: bool) -> None:
        """Take no more; queued messages are still delivered unless they are to be discarded."""
        with message_lock:
            self._state = _CLOSED
            if discard:
                self._queue.clear()
                self._noted.clear()


class Subscription:
    """Callbacks with a queue on a strand, connected to one topic or to none."""

    __slots__ = tuple(
        """_callbacks adapt closed connection converter datatype failed options owner queue_size
        receive strand traffic""".split()
    )

    def __init__(
        self,
        datatype: Any,
        queue_size: int | None,
        strand: Strand,
        failed: Callable[[BaseException], None],
        options: dict[str, Any],
        owner: str,
        adapt: Callable[[Receive], Receive],
    ) -> None:
        """Describe a subscription.

        ``failed`` is called with the errors of its callbacks, and ``adapt`` converts the messages
        of its topic for callbacks.
        """
        self.datatype = datatype
        self.adapt = adapt
        self.queue_size = queue_size
        self.strand = strand
        self.failed = failed
        self.options = options
        self.owner = owner
        #: With the arguments that follow the message.
        self._callbacks: tuple[tuple[Callable[..., Any], tuple[Any, ...]], ...] = ()
        self.receive: Receive = _ignore  # called with each message, on the strand
        self.traffic = Traffic(strand.clock)
        self.connection: Connection | None = None
        #: Once a publication of a special class of messages has been on its topic.
        self.converter: Converter | None = None
        self.closed = False

    @property
    def topic(self) -> str:
        """Global name of the connected topic, empty when disconnected."""
        return self.connection.topic if self.connection is not None else ""

    @property
    def outside(self) -> OutsideSubscriber | None:
        return self.connection.outside if self.connection is not None else None

    def add(self, callback: Callable[..., Any], args: tuple[Any, ...]) -> int:
        """Call this back too; returns the number of the callback."""
        with message_lock:
            self._callbacks = (*self._callbacks, (callback, args))
            self._receive_by_callbacks()
            return len(self._callbacks) - 1

    def convert(self, converter: Converter) -> None:
        """Convert the messages from now on; the lock is held."""
        if self.converter is None:
            self.converter = converter
            self._receive_by_callbacks()

    def _receive_by_callbacks(self) -> None:
        if not self._callbacks:
            return
        callback, args = self._callbacks[0]
        alone = len(self._callbacks) == 1 and not args
        receive = self.adapt(callback if alone else self._call_all)
        converter, datatype = self.converter, self.datatype
        if converter is None:
            self.receive = receive
        else:
            self.receive = lambda message: receive(converter(datatype, message))

    def _call_all(self, message: Any) -> None:
        errors: list[BaseException] = []
        for callback, args in self._callbacks:
            try:
                callback(message, *args)
            except BaseException as error:  # the boundary, for each callback by itself
                errors.append(error)
        while errors:
            self.failed(errors.pop(0))

    def let_go(self) -> None:
        """Drop the callbacks after the release: they refer to the nodelet, and it to this."""
        self.receive, self._callbacks = _ignore, ()


class Publication:
    """The sending end of a nodelet, connected to one topic or to none.

    ``publish`` looks at the route once, so a message goes wholly where the publication was
    connected at that moment.
    """

    __slots__ = tuple(
        """_build _converter _fence _is_plain _is_sample_wanted _route _sample _sample_of
        _watchers closed datatype latch latched options outside owner queue_size refusal topic
        traffic""".split()
    )

    def __init__(
        self,
        datatype: Any,
        latch: bool,
        queue_size: int | None,
        transport: Transport,
        clock: Clock,
        refusal: Callable[[], Exception],
        options: dict[str, Any],
        owner: str,
    ) -> None:
        self.datatype = datatype
        self.latch = latch
        self.queue_size = queue_size
        self.options = options
        self.owner = owner
        self.refusal = refusal
        self.topic = ""
        self.traffic = Traffic(clock)
        self.latched = NOTHING
        self.outside: OutsidePublisher | None = None  # the registration in ROS
        self.closed = False
        self._build = transport.build
        self._converter = transport.converter(datatype)
        self._sample_of = transport.sample_of
        self._sample: tuple[float | None, int] = (None, 0)
        self._is_sample_wanted = False
        self._fence: Fence | None = None
        self._route: tuple[Connection, ...] | None = None
        #: Whether messages only pass: the one question that a publish asks of all the above.
        self._is_plain = False
        self._watchers: tuple[Callable[[], None], ...] = ()

    def publish(self, message: Any = NOTHING, /, *fields: Any, **named: Any) -> None:
        """Publish a message, or the message made of the given fields, as in rospy.

        Raises:
            HandleClosed: the publication was unregistered or its nodelet unloaded (in ROS, a
                ``rospy.ROSException``).
        """
        if message.__class__ is not self.datatype or fields or named:
            message = self.built(message, fields, named)
        if not _attempt(False):
            _wait()
        try:
            if not (self._is_plain or self._admit(message)):
                return
            traffic = self.traffic  # counted here: a call would cost as much again
            traffic.messages = number = traffic.messages + 1
            now = traffic.clock()
            if number % _STRETCH == 1 or now - traffic.last > _PAUSE:
                traffic.begin_stretch(number, now)
            traffic.last = now
            for connection in self._route:  # type: ignore[union-attr] # there is one, if admitted
                connection.push_locked(message)
            outside = self.outside
            if outside is None or not (self.latch or outside.heard):
                return
            outside.in_flight += 1
        finally:
            _leave()
        _hand_over(outside, outside.latch if self.latch else outside.publish, message)

    def built(self, message: Any, fields: tuple[Any, ...], named: dict[str, Any]) -> Any:
        """Return the message that the arguments of ``publish`` stand for."""
        if message is not NOTHING:
            fields = (message, *fields)
        return self._build(self.datatype, fields, named)

    @property
    def heard(self) -> bool:
        """Whether a message published now reaches a subscriber, or is kept for later."""
        outside = self.outside
        return bool(self.latch or self._route or (outside is not None and outside.heard))

    def drop(self) -> None:
        """Count a message that could not be published."""
        with message_lock:
            self.traffic.dropped += 1

    def publish_to(self, topic: str, peer: Any, message: Any) -> None:
        """Send a message to one of the ``peers`` of a topic, uncounted; nothing if it has left."""
        with message_lock:
            if topic != self.topic or self._is_fenced():
                return
            if peer is HERE:
                for connection in self._route or ():
                    connection.push_locked(message)
            outside = self.outside
            if outside is None:
                return
            outside.in_flight += 1
        _hand_over(outside, outside.publish_to, peer, message)

    def set_fence(self, fence: Fence | None) -> None:
        """Check with ``fence`` at each message whether our nodelet may publish on its topic."""
        with message_lock:
            self._fence = fence
            self._note_plain()

    def sample(self) -> tuple[float | None, int]:
        """Return how old and large a message was, and let the next one be measured.

        It was the first one after the previous call: the seconds from its stamp to its publication
        and its bytes, None and 0 where these are not known.
        """
        with message_lock:
            self._is_sample_wanted = True
            self._note_plain()
            return self._sample

    def set_outside(self, outside: OutsidePublisher | None) -> None:
        """Publish through this registration too."""
        with message_lock:
            self._set_outside(outside)
        self._changed()

    def set_outside_unless_published(self, outside: OutsidePublisher, before: int) -> Any:
        """Publish through ``outside`` if nothing was published since ``before``.

        Returns the latched message that it is owed; without one ``NOTHING``, and nothing changes.
        """
        with message_lock:
            if self.traffic.messages != before:
                return NOTHING
            if self.latched is not NOTHING:
                self._set_outside(outside)
            return self.latched

    def connect(
        self,
        topic: str,
        outside: OutsidePublisher | None,
        route: tuple[Connection, ...] | None,
        fence: Fence | None = None,
    ) -> tuple[int, Any]:
        """Publish on another topic from now on; nowhere, if ``route`` is None.

        Returns how many messages were published before, and the latched one of them.
        """
        with message_lock:
            self._fence = fence
            self.topic = topic
            self._set_outside(outside)
            self._reroute(route, newcomers=route or ())
            before = self.traffic.messages, self.latched
        self._changed()
        return before

    def reroute(
        self, route: tuple[Connection, ...], newcomers: tuple[Connection, ...] = ()
    ) -> None:
        """Publish to ``route`` from now on; ``newcomers`` get a latched message first."""
        with message_lock:
            self._reroute(route, newcomers)
        self._changed()

    def close(self) -> None:
        """Publish no more, and refuse to."""
        self.closed = True
        self.connect("", None, None)

    def let_go(self) -> None:
        """Drop the latched message and the watchers, after the release."""
        self.latched, self._watchers = NOTHING, ()

    def peers(self) -> tuple[str, tuple[Any, ...]]:
        """The topic and its subscribers: each outside, and ``HERE`` for all of this process."""
        with message_lock:
            topic, route, outside = self.topic, self._route, self.outside
        listening = outside.peers() if outside is not None else ()
        return topic, (listening if HERE in listening or not route else (HERE, *listening))

    def watch(self, changed: Callable[[], None]) -> None:
        """Call ``changed``, which must be quick, whenever ``peers`` may have changed."""
        with message_lock:
            self._watchers = (*self._watchers, changed)

    def unwatch(self, changed: Callable[[], None]) -> None:
        with message_lock:
            self._watchers = tuple(each for each in self._watchers if each != changed)

    def _changed(self) -> None:
        for changed in self._watchers:
            changed()

    # Under the lock:

    def _admit(self, message: Any) -> bool:
        """Latch a message, sample its age and size; returns whether it may be sent."""
        if self.closed:
            raise self.refusal()
        if self._route is None or self._is_fenced():
            self.traffic.dropped += 1
            if self._route is None and self.latch:
                self.latched = message
            return False
        if self.latch:
            self.latched = message
        if self._is_sample_wanted:
            self._is_sample_wanted = False
            self._note_plain()
            self._sample = self._sample_of(message)
        return True

    def _is_fenced(self) -> bool:
        fence = self._fence  # registrations call this without the lock
        return fence is not None and not fence(self.owner)

    def _note_plain(self) -> None:
        self._is_plain = (
            self._route is not None
            and self._fence is None
            and not self.latch
            and not self._is_sample_wanted
        )

    def _set_outside(self, outside: OutsidePublisher | None) -> None:
        if self.outside is not None:
            self.outside.changed = None
        self.outside = outside
        if outside is not None:
            outside.changed = self._changed
            outside.is_fenced = self._is_fenced

    def _reroute(
        self, route: tuple[Connection, ...] | None, newcomers: tuple[Connection, ...]
    ) -> None:
        self._route = route
        self._note_plain()
        if self._converter is not None:
            for connection in route or ():
                connection.subscription.convert(self._converter)
        if self.latched is not NOTHING and newcomers and not self._is_fenced():
            for connection in newcomers:
                connection.push_latched(self.latched)


def _ignore(message: Any) -> None:
    """Receive nothing."""


def _hand_over(outside: OutsidePublisher, send: Callable[..., None], *what: Any) -> None:
    """Send a message outside that was counted as in flight under the lock."""
    try:
        send(*what)
    finally:
        with message_lock:
            outside.in_flight -= 1
