# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads a topic from one of its publishers without registering a node.

A shell command or a window need not register with the master: it asks the publisher for a
connection and reads the messages from it.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
import time
from functools import partial
from typing import Any, Callable

from dyknow.errors import PeerTimeout
from dyknow.periodic import attempt, in_background
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ConnectionRefused, TcprosConnection

#: Seconds for a connection to be there.
_CONNECTING = 5.0
#: Seconds from a connection that was lost or refused to the next attempt.
_AGAIN = 0.5
#: Seconds to wait for a message before asking again whether to go on.
_READING = 1.0
#: Seconds from one message to the next where only the last one counts.
_PAUSE = 0.2
#: Seconds in which the last message is looked for, while others follow.
_CATCHING_UP = 0.05

_log = logging.getLogger("rosout.dyknow")


class TopicReader:
    """A connection to one publisher of a topic."""

    def __init__(
        self, master: Master, publisher: str, topic: str, message_class: Any, timeout: float
    ) -> None:
        """Connect within ``timeout`` seconds.

        Raises:
            LookupError: the node is unknown, or does not publish the topic.
            ConnectionRefused: the node's message type is another one.
            PeerTimeout, OSError: it does not answer in time, or the connection broke.
        """
        what = f"topic {topic} of {publisher}"
        self._class = message_class
        deadline = time.monotonic() + timeout
        node = Master(master.caller, master.ask("lookupNode", publisher), _left(deadline))
        offer = node.ask("requestTopic", topic, [["TCPROS"]])
        if not offer:
            raise LookupError(f"{publisher} offers no TCPROS connection for {topic}")
        _, host, port = offer
        fields = {
            "topic": topic,
            "type": message_class._type,
            "md5sum": message_class._md5sum,
            "callerid": master.caller,
            "tcp_nodelay": "1",
        }
        try:
            self._connection = TcprosConnection(host, port, _left(deadline))
            self._connection.keep_alive()
            self._connection.shake_hands(what, fields, deadline)
        except socket.timeout as error:
            raise PeerTimeout(what, timeout) from error

    def read(self, timeout: float, last_only: bool = False) -> Any | None:
        """Return the next message, or the last that has come; None if there is none in time.

        Raises ``OSError`` when the connection breaks; the publisher may be gone.
        """
        frame = self._frame(time.monotonic() + timeout)
        later = frame if last_only else None
        end = time.monotonic() + _CATCHING_UP
        while later is not None:
            now = time.monotonic()
            frame, later = later, self._frame(now) if now < end else None
        return None if frame is None else self._class().deserialize(frame)

    def interrupt(self) -> None:
        """End a ``read`` of another thread, which raises OSError."""
        self._connection.interrupt()

    def close(self) -> None:
        self._connection.close()

    def _frame(self, deadline: float) -> bytes | None:
        try:
            return self._connection.receive_frame(deadline)
        except socket.timeout:
            return None


class TopicFollower:
    """Passes on the messages of a node's topic, over one connection after the other.

    A connection that is lost is made again for as long as it takes. With ``last_only`` only the
    last of several messages that have arrived is handed on, and the next after a pause: reading
    large messages must not take all of the time.
    """

    def __init__(
        self,
        master: Master,
        publisher: str,
        topic: str,
        message_class: Any,
        hand_on: Callable[[Any], None],
        last_only: bool = False,
    ) -> None:
        self._open = partial(TopicReader, master, publisher, topic, message_class, _CONNECTING)
        self._what = f"following {topic}"
        self._hand_on = hand_on
        self._last_only = last_only
        self._closed = threading.Event()
        self._is_left = threading.Event()
        self._reader: TopicReader | None = None
        self._refusal = ""  # logged once

    @property
    def is_connected(self) -> bool:
        return self._reader is not None

    def start(self) -> None:
        """Start the thread that calls ``hand_on`` with each message."""
        in_background(self._what, self._run)

    def reconnect(self) -> None:
        """Leave the connection, made or in the making, for one to the node of that name now."""
        self._is_left.set()
        reader = self._reader
        if reader is not None:
            reader.interrupt()

    def close(self) -> None:
        """Disconnect, and hand on nothing more; returns at once."""
        self._closed.set()
        self.reconnect()

    def _run(self) -> None:
        while not self._closed.is_set():
            attempt(self._what, self._follow)
            self._closed.wait(_AGAIN)

    def _follow(self) -> None:
        self._is_left.clear()
        try:
            with contextlib.closing(self._open()) as reader:
                self._reader = reader
                while not (self._is_left.is_set() or self._closed.is_set()):
                    message = reader.read(_READING, self._last_only)
                    if message is not None:
                        attempt(self._what, partial(self._hand_on, message))
                        self._closed.wait(_PAUSE if self._last_only else 0.0)
        except ConnectionRefused as error:
            if str(error) != self._refusal:
                self._refusal = str(error)
                _log.warning("%s", error)
        except (PeerTimeout, LookupError, OSError) as error:
            _log.debug("%s: %s", self._what, error)
        finally:
            self._reader = None


def _left(deadline: float) -> float:
    return max(0.001, deadline - time.monotonic())
