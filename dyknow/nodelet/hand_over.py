# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Moves nodelets between processes of one host, so that no message is lost or received twice.

1. The old process starts to note the messages that the nodelet receives (``note``).
2. The new one connects to the same topics and keeps their messages (``park``): once all
   publishers are connected no message passes by both. Subscribers connect to it, too.
3. The old one waits for the last messages that the new one had received (``give``): a publisher
   that got no processor time may have messages queued for the old one alone, which come before
   those. It drains its sockets, disconnects the nodelet, waits until its callbacks have returned
   and all that it published is sent, and unloads it.
4. The new one drops the messages that the nodelet has received, and puts those that waited for it
   in the old one before the rest (``take``). The nodelet is loaded there as ever, and its
   subscriptions take these messages over.

A manager may die between any two steps, and the next one begin a move anew:

* a move begins without the messages of an earlier one, which it ends;
* parked messages are for the nodelet only once the old process has reported (``take``), and if
  it is loaded soon: it may have run elsewhere in between;
* ``give`` changes nothing, or unloads the nodelet, whose manager brings it back.

Ownership: each process has one ``HandOvers``, which owns noted and parked messages until ``end``.
"""

from __future__ import annotations

import functools
import json
import logging
import math
import threading
import time
import weakref
from dataclasses import dataclass, field, replace
from typing import Any, Callable, Iterator, Sequence, TypeVar

from dyknow.errors import CannotMove, UnknownNodelet
from dyknow.locks import state_lock
from dyknow.model.transformation import IN, OUT
from dyknow.nodelet.context import Context
from dyknow.nodelet.loading.loader import Loader
from dyknow.nodelet.middleware import Closable, OutsideSubscriber, Receive
from dyknow.nodelet.scheduler import Strand
from dyknow.nodelet.streams.endpoints import MOST_KEPT, Connection, Publication, Subscription
from dyknow.nodelet.streams.parked import ParkedConnection, digest_of
from dyknow.periodic import in_background

#: Seconds for publishers and subscribers to connect to the new process, and for the publishers of
#: a topic on which messages flow to send the next one.
PATIENCE = 2.0
_SILENCE = 0.25  # the same for the publishers of a silent topic, which cost that much
_LONGEST_CATCH_UP = 5.0  # seconds for what is queued for the old process, while it comes
LONGEST_END = 3.0  # seconds to drain the sockets of a nodelet, and for its callback to return
_EXPIRY = 120.0  # seconds after which an unfinished move is abandoned
_LOAD_EXPIRY = 10.0  # the same, once the nodelet was given away and while it is not being loaded
#: Seconds between two looks whether it is to be.
_LOOK = 1.0
_STEP = 0.002

T = TypeVar("T")

_ELSEWHERE = "it was connected elsewhere meanwhile"
_NOT_KEPT = "its messages are not kept any more"

_log = logging.getLogger("rosout.dyknow")


@dataclass(frozen=True)
class HandedTopic:
    """One connected end of a nodelet that moves."""

    topic: str  # its global name
    datatype: str  # of its messages
    direction: str  # IN or OUT
    #: Digests of the messages that it was given, each with the time of its arrival.
    given: tuple[tuple[float, bytes], ...] = ()
    waiting: tuple[bytes, ...] = ()  # messages that it has not received of these, serialised
    latch: bool = False  # of an output
    options: str = "{}"  # further ones of an output, as JSON
    flows: bool = False  # whether messages have come regularly to an input


@dataclass(eq=False)
class _Move:
    """One move of a nodelet, in one of the two processes."""

    #: Of the nodelet that moves from here; it may end meanwhile.
    context: Callable[[], Context | None] = lambda: None
    noted: list[Connection] = field(default_factory=list)  # its connections
    outputs: list[tuple[Publication, str]] = field(default_factory=list)  # with their topics
    is_given: bool = False  # whether it is just being given away
    links: list[ParkedConnection] | None = None  # kept for the nodelet that moves here
    ends: list[Any] = field(default_factory=list)  # their subscriptions, and publications
    ended: threading.Event = field(default_factory=threading.Event)
    expiry: float = 0.0  # when it is given up, in s of steady time; not during the load


class HandOvers(Closable):
    """The moves of nodelets from and to this process; for one move of a nodelet at a time.

    ``find_class`` returns the class of messages of a type, or None. ``unload`` unloads a nodelet,
    and raises UnknownNodelet if that is done already.
    """

    def __init__(
        self, loader: Loader, find_class: Callable[[str], Any], unload: Callable[[Context], object]
    ) -> None:
        self._loader = loader
        self._runtime = loader.runtime
        self._find_class = find_class
        self._unload = unload
        self._lock = state_lock("moves of nodelets")
        self._moves: dict[str, _Move] = {}  # by nodelet

    # In the old process

    def note(self, name: str) -> list[HandedTopic]:
        """Note the messages of a nodelet from now on; returns its connected ends.

        Raises CannotMove if messages would be lost, and UnknownNodelet.
        """
        context = self._context(name)
        connections: list[Connection] = []
        outputs: list[tuple[Publication, str]] = []
        for each in context.endpoints():
            if self._find_class(each.datatype._type) is not each.datatype:
                what = f"its end at {each.topic or 'no topic'} is of another class than its type's"
                raise CannotMove(name, what)
            if isinstance(each, Publication) and each.topic:
                outputs.append((each, each.topic))
            elif isinstance(each, Subscription) and each.connection is not None:
                connections.append(each.connection)
        self._begin(name, _Move(weakref.ref(context), connections, outputs))
        for connection in connections:
            connection.note(True)
        return [*map(_input, connections), *_outputs(outputs)]

    def give(self, name: str, parked: Sequence[HandedTopic] = ()) -> list[HandedTopic]:
        """Unload a noted nodelet; returns its ends, with their messages.

        ``parked`` is what ``park`` returned in the new process.

        Raises:
            CannotMove: it runs on, untouched.
            Exception: it is unloaded.
        """
        context = self._context(name)
        with self._lock:
            move = self._moves.get(name)
            if move is None or move.is_given or move.context() is not context:
                raise CannotMove(name, _ELSEWHERE)
            move.is_given = True
        try:
            self._catch_up(move, parked)
            deadline = time.monotonic() + LONGEST_END
            registrations = self._detached(name, move, deadline)
        except BaseException:
            move.is_given = False
            if move.ended.is_set():
                self._end(name, move)
            raise
        context.is_leaving = True
        try:
            for registration in registrations:
                registration.close()
            context.stop()
            while context.is_busy() and time.monotonic() < deadline:
                time.sleep(_STEP)
            given = list(map(self._taken, move.noted))
            last = time.monotonic() + PATIENCE
            for end in context.endpoints():
                if isinstance(end, Publication) and end.outside is not None:
                    end.outside.drain(max(0.0, last - time.monotonic()))
        except BaseException:
            _log.exception("%s could not be given away; it is unloaded", name)
            raise
        finally:  # it is disconnected and stopped, and must not stay so
            try:
                self._unload(context)
            finally:
                move.is_given = False
                self._end(name, move)
        return [*given, *_outputs(move.outputs)]

    def _catch_up(self, move: _Move, parked: Sequence[HandedTopic]) -> None:
        """Wait until the messages have come that the new process had received, or time is up.

        They do not come if a publisher has dropped them from its queue for this process. While
        any message comes there is more time.
        """
        began = time.monotonic()
        until = began + PATIENCE
        for connection, topic in zip(move.noted, _inputs(parked)):
            due, last = {digest for _, digest in topic.given}, -math.inf
            while due and not move.ended.is_set() and time.monotonic() < until:
                noted = connection.noted(last)
                for _, message in noted:
                    due.discard(digest_of(message, self._runtime.transport.digest) or b"")
                if noted:
                    last = noted[-1][0]
                    until = min(time.monotonic() + PATIENCE, began + _LONGEST_CATCH_UP)
                else:
                    time.sleep(_STEP)

    def _detached(self, name: str, move: _Move, deadline: float) -> list[OutsideSubscriber]:
        """Disconnect a nodelet; returns registrations that are to be withdrawn.

        Raises CannotMove if it is connected elsewhere, before or meanwhile.
        """
        connections = move.noted
        if any(each.subscription.connection is not each for each in connections):
            raise CannotMove(name, _ELSEWHERE)
        registrations = None
        try:
            outside = [each.outside for each in connections if each.outside is not None]
            for registration in outside:
                registration.drain(max(0.0, deadline - time.monotonic()))
            if not move.ended.is_set():
                registrations = self._runtime.bus.detach(connections, move.outputs)
        finally:
            if registrations is None:
                for each in connections:
                    self._runtime.bus.renew(each)
        if registrations is None:
            raise CannotMove(name, _ELSEWHERE)
        return registrations

    def _taken(self, connection: Connection) -> HandedTopic:
        """Return what came to a connection, but for messages that cannot be serialised.

        Those came by reference, so the new process has not received them.
        """
        transport = self._runtime.transport
        given, waiting = connection.take()
        digests = ((when, digest_of(message, transport.digest)) for when, message in given)
        packed = _successes(connection, transport.pack, waiting)
        return replace(
            _input(connection),
            given=tuple((when, digest) for when, digest in digests if digest is not None),
            waiting=tuple(packed),
        )

    # In the new process

    def park(self, name: str, topics: Sequence[HandedTopic]) -> list[HandedTopic]:
        """Keep the messages on the topics of a nodelet that is to be loaded here.

        Returns its inputs, each with the last message of every publisher that has sent one since.

        Raises CannotMove if a publisher does not connect, and the errors of ``Bus.park``.
        """
        runtime = self._runtime
        strand = Strand(runtime.executor, name)  # which nothing is posted to: they stay held
        links: list[ParkedConnection] = []
        publications: list[tuple[Publication, str]] = []
        for each in topics:
            datatype = self._find_class(each.datatype)
            if datatype is None:
                raise CannotMove(name, f"{each.topic} carries {each.datatype}, unknown there")
            if each.direction == IN:
                end = Subscription(datatype, MOST_KEPT, strand, _ignore, {}, name, _as_it_is)
                links.append(ParkedConnection(end, each.topic, runtime.transport.digest))
            else:
                refusal = functools.partial(runtime.node.closed, name)
                publication = Publication(
                    datatype,
                    each.latch,
                    1,
                    runtime.transport,
                    runtime.clock,
                    refusal,
                    json.loads(each.options),
                    name,
                )
                publications.append((publication, each.topic))
        move = _Move(ends=[*(each.subscription for each in links), *(p for p, _ in publications)])
        self._begin(name, move)
        try:
            missing = runtime.bus.park(links, publications, PATIENCE)
            if missing:
                problem = f"publishers do not connect within {PATIENCE:g} s: {', '.join(missing)}"
                raise CannotMove(name, problem)
        except BaseException:
            self._end(name, move)
            raise
        move.links = links
        if move.ended.is_set():
            runtime.bus.unpark(move.ends)
            raise CannotMove(name, "its move was ended meanwhile")
        began = time.monotonic()
        inputs = _inputs(topics)
        for link, each in zip(links, inputs):
            until = began + (PATIENCE if each.flows else _SILENCE)
            if link.outside is not None:
                link.outside.hear(link.arrived, max(0.0, until - time.monotonic()))
        return [replace(e, given=tuple(link.latest())) for link, e in zip(links, inputs)]

    def take(self, name: str, topics: Sequence[HandedTopic]) -> None:
        """Drop the messages that a parked nodelet received in its old process.

        Raises CannotMove if it is not parked any more.
        """
        with self._lock:
            move = self._moves.get(name)
        if move is None or move.links is None:
            raise CannotMove(name, _NOT_KEPT)
        for link, each in zip(move.links, _inputs(topics)):
            unpack = functools.partial(self._runtime.transport.unpack, link.subscription.datatype)
            waiting = list(_successes(link, unpack, each.waiting))
            if not link.leave_out(each.given, waiting, self._runtime.bus.latched(link.topic)):
                raise CannotMove(name, _NOT_KEPT)
        move.expiry = time.monotonic() + _LOAD_EXPIRY

    # In both

    def end(self, name: str) -> None:
        """Cease to note or to keep messages for a nodelet."""
        with self._lock:
            move = self._moves.get(name)
        if move is not None:
            self._end(name, move)

    def close(self) -> None:
        with self._lock:
            left = list(self._moves.items())
        for name, move in left:
            self._end(name, move)

    def _begin(self, name: str, move: _Move) -> None:
        """Begin a move, and end an earlier one, whose manager may have died.

        Raises CannotMove while the nodelet is given away.
        """
        with self._lock:
            earlier = self._moves.get(name)
            if earlier is not None and earlier.is_given:
                raise CannotMove(name, "it is being given to another process already")
            self._moves[name] = move
        if earlier is not None:
            self._end(name, earlier)
        move.expiry = time.monotonic() + _EXPIRY
        try:
            in_background(f"moving {name}", functools.partial(self._expire, name, move))
        except BaseException:
            self._end(name, move)
            raise

    def _end(self, name: str, move: _Move) -> None:
        with self._lock:
            if self._moves.get(name) is move and not move.is_given:
                del self._moves[name]
        move.ended.set()
        for each in move.noted:
            each.note(False)
        self._runtime.bus.unpark(move.ends)

    def _expire(self, name: str, move: _Move) -> None:
        """End a move later, if a manager that died does not, but not during the load."""
        while not move.ended.wait(_LOOK):
            is_loading = self._loader.known(name) is not self._loader.find(name)
            if time.monotonic() >= move.expiry and not is_loading:
                _log.warning("%s: its move was not ended; it is given up", name)
                self._end(name, move)

    def _context(self, name: str) -> Context:
        context = self._loader.find(name)
        if context is None:
            raise UnknownNodelet(name, self._loader.list())
        return context


def _outputs(publications: Sequence[tuple[Publication, str]]) -> list[HandedTopic]:
    return [
        HandedTopic(
            topic,
            each.datatype._type,
            OUT,
            latch=each.latch,
            options=json.dumps(each.options, default=str),
        )
        for each, topic in publications
    ]


def _input(connection: Connection) -> HandedTopic:
    subscription = connection.subscription
    flows = subscription.traffic.rate() > 0
    return HandedTopic(connection.topic, subscription.datatype._type, IN, flows=flows)


def _inputs(topics: Sequence[HandedTopic]) -> list[HandedTopic]:
    return [each for each in topics if each.direction == IN]


def _as_it_is(receive: Receive) -> Receive:
    return receive


def _ignore(error: BaseException) -> None:
    """Do nothing: nothing is received."""


def _successes(
    connection: Connection, convert: Callable[[Any], T], messages: Sequence[Any]
) -> Iterator[T]:
    """Convert messages that wait; one that cannot be converted is dropped, which is logged."""
    for message in messages:
        try:
            yield convert(message)
        except Exception as error:  # the boundary to messages, whose fields may be anything
            owner, topic = connection.subscription.owner, connection.topic
            _log.warning("%s: a message on %s is lost in its move: %s", owner, topic, error)
