# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Moves nodelets between processes of one host, so that no message is lost or received twice.

1. The old process begins to note what the nodelet is given (``note``).
2. The new one connects to the same topics and keeps what comes (``park``): from when all
   publishers are connected no message passes by both. Subscribers connect to it, too.
3. The old one receives what its sockets hold, disconnects the nodelet, waits until its callbacks
   have returned and all that it published is sent, and unloads it (``give``).
4. The new one drops what the nodelet was given, and puts before the rest what waited for it in the
   old one (``take``). The nodelet is loaded there as ever, and its subscriptions take over what
   has come for them.

Ownership: each process has one ``HandOvers``, which owns what is noted or parked until ``end``.
"""

from __future__ import annotations

import functools
import logging
import threading
import time
from dataclasses import dataclass, replace
from typing import Any, Callable, Sequence

from dyknow.errors import CannotMove, UnknownNodelet
from dyknow.locks import state_lock
from dyknow.model.transformation import IN, OUT
from dyknow.nodelet.context import Context
from dyknow.nodelet.endpoints import MOST_KEPT, Connection, Publication, Subscription
from dyknow.nodelet.loader import Loader
from dyknow.nodelet.middleware import Closable, Receive
from dyknow.nodelet.parked import ParkedConnection
from dyknow.nodelet.scheduler import Strand
from dyknow.periodic import in_background

#: Seconds for publishers and subscribers to connect to the new process.
PATIENCE = 2.0
#: Seconds for what the sockets of a nodelet hold, and for its callback to return.
LONGEST_END = 3.0
#: Seconds after which a move that nobody ends is given up.
_EXPIRY = 120.0
_STEP = 0.002

_log = logging.getLogger("rosout.dyknow")


@dataclass(frozen=True)
class HandedTopic:
    """One connected end of a nodelet that moves.

    Attributes:
        topic: its global name.
        datatype: type of its messages.
        direction: IN or OUT.
        given: digests of the messages that it was given, each with the time of its arrival.
        waiting: messages that it was given, and has not received, serialised.
    """

    topic: str
    datatype: str
    direction: str
    given: tuple[tuple[float, bytes], ...] = ()
    waiting: tuple[bytes, ...] = ()


class HandOvers(Closable):
    """The moves of nodelets from and to this process; for one move of a nodelet at a time.

    Args:
        loader: has the nodelets.
        find_class: returns the class of messages of a type; None if there is none.
        unload: unloads a nodelet by name.
    """

    def __init__(
        self,
        loader: Loader,
        find_class: Callable[[str], Any],
        unload: Callable[[str], object],
    ) -> None:
        self._loader = loader
        self._runtime = loader.runtime
        self._find_class = find_class
        self._unload = unload
        self._lock = state_lock("moves of nodelets")
        self._noted: dict[str, list[Connection]] = {}
        self._parked: dict[str, list[ParkedConnection]] = {}
        #: By nodelet, set when its move has ended.
        self._ends: dict[str, threading.Event] = {}

    # In the old process

    def note(self, name: str) -> list[HandedTopic]:
        """Note what a nodelet is given from now on; returns its connected ends.

        Raises CannotMove if messages would be lost, and UnknownNodelet.
        """
        context = self._context(name)
        connections = []
        for each in context.endpoints():
            if self._find_class(each.datatype._type) is not each.datatype:
                what = f"its end at {each.topic or 'no topic'} is of another class than its type's"
                raise CannotMove(name, what)
            if isinstance(each, Subscription) and each.connection is not None:
                connections.append(each.connection)
        for connection in connections:
            connection.note(True)
        with self._lock:
            self._noted[name] = connections
        self._expire(name)
        return [*map(_input, connections), *self._outputs(context)]

    def give(self, name: str) -> list[HandedTopic]:
        """Unload a noted nodelet; returns its ends, with what it was given."""
        context = self._context(name)
        with self._lock:
            connections = self._noted.get(name)
        if connections is None or [each.subscription.connection for each in connections] != [
            *connections
        ]:
            raise CannotMove(name, "it was connected elsewhere meanwhile")
        outputs = self._outputs(context)
        deadline = time.monotonic() + LONGEST_END
        for each in connections:
            if each.outside is not None:  # some may have been sent before the new one connected
                each.outside.drain(max(0.0, deadline - time.monotonic()))
        self._runtime.bus.rewire([(each.subscription, "") for each in connections])
        context.stop()
        while context.is_busy() and time.monotonic() < deadline:
            time.sleep(_STEP)
        given = list(map(self._taken, connections))
        for end in context.endpoints():
            if isinstance(end, Publication) and end.outside is not None:
                end.outside.drain(PATIENCE)
        self._unload(name)
        self.end(name)
        return [*given, *outputs]

    def _taken(self, connection: Connection) -> HandedTopic:
        transport = self._runtime.transport
        given, waiting = connection.take()
        return replace(
            _input(connection),
            given=tuple((moment, transport.digest(message)) for moment, message in given),
            waiting=tuple(map(transport.pack, waiting)),
        )

    # In the new process

    def park(self, name: str, topics: Sequence[HandedTopic]) -> None:
        """Keep what comes on the topics of a nodelet that is to be loaded here.

        Raises CannotMove if one of the publishers does not connect, and what ``Bus.park`` does.
        """
        runtime = self._runtime
        strand = Strand(runtime.executor, name, held=True)
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
                    datatype, False, 1, runtime.transport, runtime.clock, refusal, {}, name
                )
                publications.append((publication, each.topic))
        missing = runtime.bus.park(links, publications, PATIENCE)
        if missing:
            listed = ", ".join(missing)
            raise CannotMove(name, f"publishers do not connect within {PATIENCE:g} s: {listed}")
        with self._lock:
            self._parked[name] = links
        self._expire(name)

    def take(self, name: str, topics: Sequence[HandedTopic]) -> None:
        """Leave out what a parked nodelet was given where it was.

        Raises CannotMove if it is not parked any more.
        """
        with self._lock:
            links = self._parked.get(name)
        if links is None:
            raise CannotMove(name, "its messages are not kept any more")
        inputs = [each for each in topics if each.direction == IN]
        for link, each in zip(links, inputs):
            unpack = functools.partial(self._runtime.transport.unpack, link.subscription.datatype)
            link.leave_out(each.given, list(map(unpack, each.waiting)))

    # In both

    def end(self, name: str) -> None:
        """Cease to note or to keep messages for a nodelet."""
        with self._lock:
            noted, parked = self._noted.pop(name, ()), self._parked.pop(name, None)
            ended = self._ends.pop(name, None)
        for each in noted:
            each.note(False)
        if parked is not None:
            self._runtime.bus.unpark(name)
        if ended is not None:
            ended.set()

    def close(self) -> None:
        with self._lock:
            left = [*self._noted, *self._parked]
        for name in left:
            self.end(name)

    def _expire(self, name: str) -> None:
        """End a move later, if a manager that died does not."""
        with self._lock:
            ended = self._ends[name] = threading.Event()

        def expire() -> None:
            if not ended.wait(_EXPIRY):
                _log.warning("%s: its move was not ended; it is given up", name)
                self.end(name)

        in_background(f"moving {name}", expire)

    def _context(self, name: str) -> Context:
        context = self._loader.find(name)
        if context is None:
            raise UnknownNodelet(name, self._loader.list())
        return context

    @staticmethod
    def _outputs(context: Context) -> list[HandedTopic]:
        return [
            HandedTopic(each.topic, each.datatype._type, OUT)
            for each in context.endpoints()
            if isinstance(each, Publication) and each.topic
        ]


def _input(connection: Connection) -> HandedTopic:
    return HandedTopic(connection.topic, connection.subscription.datatype._type, IN)


def _as_it_is(receive: Receive) -> Receive:
    return receive


def _ignore(error: BaseException) -> None:
    """Do nothing: nothing is received."""
