"""Counts messages on topics whose publishers cannot be asked, by listening to them.

Registering with the ROS master may take its time, so a thread does it, one registration after the
other. rospy has one connection to each publisher, however many listen.
"""

from __future__ import annotations

import time
from typing import Any, Callable, Optional

import rospy

from dyknow.manager.host import Count, Listening
from dyknow.ros.transport.registrar import Registrar
from dyknow.workers import Workers

#: Seconds to wait, at the end, for a registration that is going on.
_END_PATIENCE = 0.5


class MessageCounter:
    """Begins to listen, and ends it, without letting anybody wait."""

    def __init__(self, registrar: Registrar) -> None:
        """Listen to nothing yet; ``registrar`` knows what the master has yet to be told."""
        self._registrar = registrar
        self._registrations = Workers("registering to count messages", 1)

    def listen(self, topic: str) -> Listening:
        """Begin to count the messages of a topic, of any type."""
        return _Ear(topic, self._registrar, self._registrations.run)

    def close(self) -> None:
        """Begin nothing any more."""
        self._registrations.close(_END_PATIENCE)


class _Ear(Listening):
    def __init__(
        self, topic: str, registrar: Registrar, run: Callable[[Callable[[], None]], None]
    ) -> None:
        self._topic = topic
        self._registrar = registrar
        self._run = run
        self._messages = 0
        self._closed = False
        self._subscriber: Optional[Any] = None
        run(self._register)

    def count(self) -> Optional[Count]:
        if self._subscriber is None or not self._registrar.is_subscribed(self._topic):
            return None
        now = time.monotonic()
        return Count(self._messages, now, now)

    def close(self) -> None:
        self._closed = True
        self._run(self._unregister)

    def _register(self) -> None:
        if not self._closed:
            self._subscriber = rospy.Subscriber(
                self._topic, rospy.AnyMsg, self._hear, queue_size=1
            )

    def _unregister(self) -> None:
        if self._subscriber is not None:
            self._subscriber.unregister()

    def _hear(self, message: Any) -> None:
        self._messages += 1
