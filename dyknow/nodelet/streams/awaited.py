# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The place of a registration that is still being made.

A publication that moves to a topic with subscribers in this process publishes there at once. Its
registration follows, which takes as long as the master does. `AwaitedPublisher` keeps the messages
of that time for the outside, and passes them on, in order.

One that latches owes a new registration its last message. What another thread publishes while that
is sent waits here, and follows it.
"""

from __future__ import annotations

import collections
import logging
import threading
import time
from typing import Any

from dyknow.locks import state_lock
from dyknow.nodelet.middleware import OutsidePublisher
from dyknow.nodelet.streams.endpoints import MOST_KEPT, NOTHING

#: Seconds for which a later message waits at most until those that were kept are sent.
_LONGEST_PASSING = 1.0
_STEP = 0.002

_log = logging.getLogger("rosout.dyknow")


class AwaitedPublisher(OutsidePublisher):
    """Keeps the messages of one publication, up to its queue size, until ``pass_to``.

    A ``queue_size`` of 0 or None is no bound. The ``registration`` has the peers meanwhile, if it
    is there already.
    """

    heard: bool = True

    def __init__(
        self,
        topic: str,
        queue_size: int | None,
        latch: bool = False,
        registration: OutsidePublisher | None = None,
    ) -> None:
        self.in_flight = 0
        self.changed = None
        #: A latched message that the registration gets unless one is published before.
        self.owed = NOTHING
        self._latch = latch
        self._registration = registration
        self._topic = topic
        self._lock = state_lock("messages for a registration")
        self._kept: collections.deque[Any] = collections.deque(maxlen=queue_size or MOST_KEPT)
        self._successor: OutsidePublisher | None = None
        self._passing_thread = 0
        self._is_passed = threading.Event()
        self._is_closed = False

    def peers(self) -> tuple[Any, ...]:
        return self._registration.peers() if self._registration is not None else ()

    def publish(self, message: Any) -> None:
        """Keep a message; later ones follow those that were kept."""
        with self._lock:
            successor = self._successor
            if successor is None:
                if not self._is_closed:
                    self._kept.append(message)
                return
        if threading.get_ident() != self._passing_thread:  # a finalizer may publish there
            self._is_passed.wait(_LONGEST_PASSING)
        self._send(successor, message)

    def publish_to(self, peer: Any, message: Any) -> None:
        if self._registration is not None:
            self._registration.publish_to(peer, message)

    def latch(self, message: Any) -> None:
        """Keep a message likewise; the registration latches it."""
        self.publish(message)

    def wait(self, seconds: float) -> None:
        """Return at once: nobody can connect yet."""

    def pass_to(self, successor: OutsidePublisher) -> None:
        """Send all that was kept through the registration, and what still comes after it."""
        with self._lock:
            self._successor, self._passing_thread = successor, threading.get_ident()
            kept = list(self._kept) or [each for each in (self.owed,) if each is not NOTHING]
            self._kept.clear()
        try:
            for message in kept:
                try:
                    self._send(successor, message)
                except Exception as error:  # the boundary: its publisher has gone on
                    _log.warning("a message on %s was not sent: %s", self._topic, error)
        finally:
            self._is_passed.set()

    def drain(self, seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while self._kept or self.in_flight:
            if time.monotonic() >= deadline:
                return False
            time.sleep(_STEP)
        return True

    def close(self) -> None:
        with self._lock:
            self._is_closed, self.owed = True, NOTHING
            self._kept.clear()

    def _send(self, successor: OutsidePublisher, message: Any) -> None:
        (successor.latch if self._latch else successor.publish)(message)
