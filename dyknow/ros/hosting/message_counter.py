# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Counts the messages on topics, by subscribing.

Registering with the ROS master may take its time, so one thread does that for all topics. rospy
has one connection to each publisher, however many subscribe.
"""

from __future__ import annotations

import time
from typing import Any

import rospy

from dyknow.locks import state_lock
from dyknow.manager.host import Count, Listening
from dyknow.nodelet.parked import latching
from dyknow.periodic import Workers
from dyknow.ros.transport.registrar import Registrar
from dyknow.ros.wire.ages_and_sizes import age_of_serialised

#: Seconds to wait, at the end, for a registration that is going on.
_END_PATIENCE = 0.5


class MessageCounter:
    """Makes a handle for each topic to be counted; none of its methods waits for the master."""

    def __init__(self, registrar: Registrar) -> None:
        """Prepare; ``registrar`` knows the registrations that the master has yet to confirm."""
        self._registrar = registrar
        self._registrations = Workers("registering to count messages", 1)

    def listen(self, topic: str) -> Listening:
        """Count the messages of a topic of any type from now on."""
        return _TopicCounter(topic, self._registrar, self._registrations)

    def close(self) -> None:
        """Register nothing any more."""
        self._registrations.close(_END_PATIENCE)


class _TopicCounter(Listening):
    def __init__(self, topic: str, registrar: Registrar, registrations: Workers) -> None:
        self._topic = topic
        self._registrar = registrar
        self._registrations = registrations
        self._state_lock = state_lock("message counter")
        self._messages = 0
        self._age: float | None = None
        self._is_latched = False
        self._is_age_wanted = True
        self._closed = False
        self._subscriber: Any | None = None
        registrations.run(self._register)

    def count(self) -> Count | None:
        if self._subscriber is None or not self._registrar.is_subscribed(self._topic):
            return None
        now = time.monotonic()
        with self._state_lock:
            self._is_age_wanted = True
            return Count(self._messages, now, now, self._is_latched, age=self._age)

    def close(self) -> None:
        self._closed = True
        self._registrations.run(self._unregister)

    # Both are called by the one thread of registrations.

    def _register(self) -> None:
        if not self._closed:
            self._subscriber = rospy.Subscriber(
                self._topic, rospy.AnyMsg, self._add_one, queue_size=1
            )

    def _unregister(self) -> None:
        if self._subscriber is not None:
            self._subscriber.unregister()

    def _add_one(self, message: Any) -> None:
        with self._state_lock:  # rospy calls from a thread for each publisher
            self._messages += 1
            self._is_latched = bool(latching(message))
            is_age_wanted, self._is_age_wanted = self._is_age_wanted, False
        if is_age_wanted:
            self._age = age_of_serialised(message)
