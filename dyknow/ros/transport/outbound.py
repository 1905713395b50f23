# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""One subscriber outside: its queue of messages, and the regions that it has yet to copy.

rospy gives each connection a thread, and each message waits for it. Here a message is written by
the thread that publishes it, as far as that needs no waiting. A thread of the connection's own
writes the rest, and ends with it.
"""

from __future__ import annotations

import collections
import contextlib
import select
import socket
from typing import Any, NamedTuple

from rospy.exceptions import TransportTerminated

from dyknow.locks import state_lock
from dyknow.periodic import NO_THREAD, in_background
from dyknow.ros.transport.arena import Arena, ArenaRegion

#: The transport of a subscriber that has our memory open.
SHMROS = "SHMROS"
#: Bytes that a subscriber may have yet to copy, or one message, before it is sent more.
WINDOW = 1 << 20
#: Seconds between two looks whether a connection has ended.
_LOOK = 1.0


def wider(one: int, another: int) -> int:
    """Return the larger of two sizes of queues; 0 is without a bound."""
    return max(one, another) if one and another else 0


class Share(NamedTuple):
    """A message in shared memory, on its way to one subscriber."""

    frame: bytes
    region: ArenaRegion


class Outbound:
    """A connection of rospy to a subscriber, which takes frames and shares.

    At most ``queue_size`` messages wait, with 0 or None any number. Without the arena of this
    process it shares no memory.
    """

    def __init__(self, connection: Any, queue_size: int | None, arena: Arena | None) -> None:
        self._connection = connection
        self._queue_size = queue_size or 0
        self._arena = arena
        self._lock = state_lock("connection to a subscriber")
        self._queue: collections.deque[bytes | Share] = collections.deque()
        #: The rest of a frame that was begun.
        self._rest = memoryview(b"")
        self._is_sending = False
        self._has_thread = False
        #: Regions that the subscriber has yet to copy, and their bytes.
        self._uncopied: collections.deque[ArenaRegion] = collections.deque()
        self._in_flight = 0
        self._greeting = b""
        #: Whether the subscriber has our memory open.
        self.is_shared = False

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self._connection, name)

    @property
    def transport_type(self) -> str:
        """The name of the transport, for ``rosnode info``."""
        self.shares()
        return str(self._connection.transport_type)

    def __del__(self) -> None:
        if self._arena is not None:
            self._arena.linger(tuple(self._uncopied))

    def write_data(self, data: bytes | Share) -> bool:
        """Write a message now, or queue it; ``TransportTerminated`` when the subscriber has gone.

        Beyond the size of the queue the oldest message in it goes.
        """
        with self._lock:
            if self._is_sending:
                if len(self._queue) == self._queue_size > 0:
                    self._queue.popleft()
                self._queue.append(data)
                if self._has_thread:
                    return True
            elif not self._begin(data):
                self._queue.append(data)
            elif not self._rest:
                return True
            self._is_sending = self._has_thread = True
        try:
            in_background(f"sending {self._connection.name}", self._send)
        except NO_THREAD:  # the next message tries again; what is logged is a message, too
            self._has_thread = False
        return True

    def widen(self, queue_size: int) -> None:
        """Keep so many messages from now on, if that is more; 0 for any number."""
        with self._lock:
            self._queue_size = wider(self._queue_size, queue_size)

    def shares(self) -> bool:
        """Whether the subscriber has our memory open by now."""
        if not self.is_shared:
            with self._lock, contextlib.suppress(TransportTerminated):
                self._listen()
        return self.is_shared

    def is_idle(self) -> bool:
        """Whether everything was sent, and copied, as far as the subscriber is there."""
        with self._lock:
            if self._is_sending or self._connection.done:
                return bool(self._connection.done)
            try:
                self._listen()
            except TransportTerminated:
                return True
            return not self._in_flight

    def _send(self) -> None:
        """Write the queue, until it is empty or the subscriber has gone."""
        while True:
            with self._lock:
                awaited = 0
                try:
                    while (self._rest or self._queue) and not awaited:
                        awaited = self._write_on()
                except TransportTerminated:
                    self._queue.clear()
                    self._rest = memoryview(b"")
                if not awaited:
                    self._is_sending = self._has_thread = False
                    return
            poll = select.poll()
            with contextlib.suppress(OSError, ValueError, TypeError):  # closed just now
                poll.register(self._connection.socket, awaited)
                poll.poll(_LOOK * 1000)

    # Under the lock:

    def _write_on(self) -> int:
        """Write some more; returns what to wait for on the socket before the next attempt."""
        if self._rest:
            self._rest = self._rest[self._write(self._rest) :]
            return select.POLLOUT if self._rest else 0
        data = self._queue[0]
        if self._begin(data):
            self._queue.popleft()
            return select.POLLOUT if self._rest else 0
        return select.POLLIN if self._is_full(data) else select.POLLOUT

    def _begin(self, data: bytes | Share) -> bool:
        """Write the beginning of a message, mostly all of it; False if nothing was taken."""
        if isinstance(data, Share):
            self._listen()
            if self._is_full(data):
                return False
        frame = data.frame if isinstance(data, Share) else data
        written = self._write(frame)
        if not written:
            return False
        self._rest = memoryview(frame)[written:]
        connection = self._connection
        connection.stat_num_msg += 1
        if isinstance(data, Share):
            self._uncopied.append(data.region)
            self._in_flight += data.region.size
            connection.stat_bytes += data.region.size
        return True

    def _is_full(self, data: bytes | Share) -> bool:
        if not isinstance(data, Share) or not self._in_flight:
            return False
        return self._in_flight + data.region.size > WINDOW

    def _write(self, data: Any) -> int:
        connection = self._connection
        try:
            written = int(connection.socket.send(data, socket.MSG_DONTWAIT))
        except BlockingIOError:
            return 0
        except (OSError, AttributeError) as error:  # it was closed, here or there
            raise TransportTerminated(str(error)) from error
        connection.stat_bytes += written
        return written

    def _listen(self) -> None:
        """Take the subscriber's greeting, and note which regions it has copied."""
        try:
            said = self._connection.socket.recv(4096, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        except (OSError, AttributeError) as error:
            raise TransportTerminated(str(error)) from error
        if not said:
            raise TransportTerminated("the subscriber has gone")
        if not self.is_shared and self._arena is not None:
            self._greeting += said
            expected = self._arena.address.encode()
            said = self._greeting[len(expected) :]
            self.is_shared = self._greeting.startswith(expected)
            if self.is_shared:
                self._connection.transport_type = SHMROS
            else:
                self._greeting = self._greeting[: len(expected)]  # a stranger may send anything
        for _ in range(min(len(said), len(self._uncopied))):
            self._in_flight -= self._uncopied.popleft().size
