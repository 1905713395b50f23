# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Passes events to a listener one at a time, in their order, outside the locks that order them."""

from __future__ import annotations

from collections import deque
from typing import Callable, Deque, Generic, TypeVar

from dyknow.locks import state_lock

Event = TypeVar("Event")


class EventQueue(Generic[Event]):
    """Events on their way to one listener; safe from any thread."""

    def __init__(self, listener: Callable[[Event], None]) -> None:
        """Begin empty.

        Args:
            listener: called with each event.
        """
        self.listener = listener
        self._state_lock = state_lock("event queue")
        self._events: Deque[Event] = deque()
        self._delivering = False

    def add(self, event: Event) -> None:
        """Append an event; called under the lock that decides the order."""
        with self._state_lock:
            self._events.append(event)

    def deliver(self) -> None:
        """Pass all events to the listener, unless another thread does; called under no lock."""
        while True:
            with self._state_lock:
                if self._delivering or not self._events:
                    return
                event = self._events.popleft()
                self._delivering = True
            try:
                self.listener(event)
            finally:
                with self._state_lock:
                    self._delivering = False
