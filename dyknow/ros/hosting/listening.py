# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Topics to which a host subscribes: it counts their messages, and hears verdicts.

Registering with the ROS master may take its time, so a thread does that. rospy has one connection
to each publisher, however many subscribe, and all subscribers of a process to one topic share the
message class of the first: so every topic is heard as ``rospy.AnyMsg``.
"""

from __future__ import annotations

import time
from functools import partial
from typing import Any, Callable, Collection

import rospy
from dyknow_msgs.msg import Verdict

from dyknow.locks import state_lock
from dyknow.manager.host import Count, HeardVerdict, Listening
from dyknow.nodelet.streams.parked import latching
from dyknow.periodic import Workers
from dyknow.ros.transport.registrar import Registrar
from dyknow.ros.wire.ages_and_sizes import age_of_serialised

#: Seconds for registrations that are going on when it is closed.
_END_PATIENCE = 1.0


class TopicCounter(Listening):
    """Counts the messages of a topic of any type.

    Args:
        registrar: knows the registrations that the master has yet to confirm.
        registrations: one thread, which registers for all counters.
    """

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

    def _register(self) -> None:
        if not self._closed:
            # With a queue_size, rospy drops all but the last messages that have come together.
            self._subscriber = rospy.Subscriber(
                self._topic, rospy.AnyMsg, self._add_one, tcp_nodelay=True
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


class VerdictTopics:
    """Subscribes to topics of verdicts; no method waits for the master."""

    def __init__(self, on_change: Callable[[], object]) -> None:
        """Subscribe to nothing yet; ``on_change`` is called when a verdict differs."""
        self._on_change = on_change
        self._state_lock = state_lock("verdicts")
        self._heard: dict[str, HeardVerdict] = {}
        self._wanted: frozenset[str] = frozenset()
        self._subscribers: dict[str, rospy.Subscriber] = {}
        self._registrations = Workers("subscribing to verdicts", 1)

    def follow(self, topics: Collection[str]) -> dict[str, HeardVerdict]:
        """Listen to these topics alone; returns the verdicts that were heard there by now."""
        wanted = frozenset(topics)
        with self._state_lock:
            is_new, self._wanted = wanted != self._wanted, wanted
            self._heard = {topic: each for topic, each in self._heard.items() if topic in wanted}
            heard = dict(self._heard)
        if is_new:
            self._registrations.run(self._register)
        return heard

    def close(self) -> None:
        """Subscribe to nothing any more."""
        self._registrations.close(_END_PATIENCE)

    def _register(self) -> None:
        """Follow the topics that are wanted by now; called by one thread."""
        wanted = self._wanted
        for topic in self._subscribers.keys() - wanted:
            self._subscribers.pop(topic).unregister()
        for topic in sorted(wanted - self._subscribers.keys()):
            hear = partial(self._hear, topic)
            self._subscribers[topic] = rospy.Subscriber(topic, rospy.AnyMsg, hear)

    def _hear(self, topic: str, serialised: Any) -> None:
        if serialised._connection_header["md5sum"] != Verdict._md5sum:
            return
        message = Verdict().deserialize(serialised._buff)
        if message.value == Verdict.UNKNOWN:
            return
        is_true, since = message.value == Verdict.TRUE, message.since.to_sec()
        now, age = time.monotonic(), rospy.get_time() - message.header.stamp.to_sec()
        verdict = HeardVerdict(is_true, now, since, message.why, state=now - max(age, 0.0))
        with self._state_lock:
            if topic not in self._wanted:
                return
            known = self._heard.get(topic)
            self._heard[topic] = verdict.after(known)
        if known is None or known.is_true is not is_true:
            self._on_change()
