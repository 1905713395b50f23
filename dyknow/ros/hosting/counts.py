# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Counts of messages: of nodelets, from their processes, and on topics, by subscribing.

Ownership: a ``CountClient`` owns a kept connection, which a key of its peer's loop alone uses from
the first request on. Registering with the ROS master may take its time, so one thread does that
for all topics. rospy has one connection to each publisher, however many subscribe.
"""

from __future__ import annotations

import math
import time
from typing import Any, Collection, Dict, Iterable, Mapping, Optional

import rospy
from dyknow_msgs.msg import Port
from dyknow_msgs.srv import GetCounts

from dyknow import names
from dyknow.errors import PeerTimeout
from dyknow.locks import state_lock
from dyknow.manager.host import Count, Listening
from dyknow.periodic import ControlLoop, Workers
from dyknow.ros.transport.registrar import Registrar
from dyknow.ros.wire.ages import age_of_serialised
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient, ServiceFailed, ServiceLost

#: Service of our nodelet managers, and of re-wirable nodes.
SERVICE = "get_counts"
#: Seconds that a caller waits for the counts of all processes together.
PATIENCE = 0.5
#: Seconds for the counts of one process; no caller waits that long.
_TIMEOUT = 2.0
#: Nodelets whose counts are requested by name; there is a limit to the size of a request.
_MOST_NAMED = 500
#: Seconds without a request after which a connection is closed until the next.
_IDLE = 10.0
#: Seconds to wait, at the end, for a registration that is going on.
_END_PATIENCE = 0.5

Counts = Dict[str, Optional[Mapping[str, Count]]]
"""By nodelet, the counts of its out-ports; None for one that is not there."""


def counts_of(asked: Iterable[tuple[CountClient, Collection[str]]]) -> Counts:
    """Ask processes for the counts of nodelets, side by side, as ``Host.counts`` does.

    A process that took longer than ``PATIENCE`` the last time is not waited for; a late reply is
    returned by the next call.
    """
    deadline = time.monotonic() + PATIENCE
    requests = [(client, nodelets, client.ask(nodelets)) for client, nodelets in asked]
    found: Counts = {}
    for client, nodelets, number in requests:
        found.update(client.replies(number, nodelets, deadline))
    return found


class CountClient:
    """Asks one process for counts, one request after the other."""

    def __init__(self, master: Master, name: str, loop: ControlLoop) -> None:
        """Prepare; the ``loop`` is started."""
        self._loop = loop
        self._key = f"counting the messages of {name}"
        self._client = ServiceClient(master, names.join(name, SERVICE), GetCounts, True)
        self._state_lock = state_lock("counts")
        self._wanted: set[str] = set()
        self._fresh: Counts = {}
        self._asked = time.monotonic()
        self._in_time = True

    def ask(self, nodelets: Collection[str]) -> int:
        """Send a request after the previous reply has arrived; returns its sequence number."""
        with self._state_lock:
            self._wanted.update(nodelets)
        self._loop.add(self._key, self._round, pause=0.0)
        return self._loop.wake(self._key)

    def replies(self, number: int, nodelets: Collection[str], deadline: float) -> Counts:
        """Wait for a reply, unless that may take long; returns new counts."""
        if self._in_time:
            left = max(0.0, deadline - time.monotonic())
            self._in_time = self._loop.wait_for(self._key, number, left)
        with self._state_lock:
            return {name: self._fresh.pop(name) for name in nodelets if name in self._fresh}

    def close(self) -> None:
        self._client.close()

    def _round(self) -> float:
        with self._state_lock:
            nodelets, self._wanted = sorted(self._wanted), set()
        began = time.monotonic()
        if not nodelets:
            if began - self._asked >= _IDLE:
                self._client.close()
            return _IDLE
        self._asked = began
        found = self._request(nodelets)
        with self._state_lock:
            self._fresh.update(found)
        self._in_time = time.monotonic() - began <= PATIENCE
        return _IDLE

    def _request(self, nodelets: list[str]) -> Counts:
        asked = time.monotonic()
        named = nodelets if len(nodelets) <= _MOST_NAMED else []  # an empty list asks for all
        try:
            answer = self._client.call(_TIMEOUT, named)
        except PeerTimeout:
            return {}
        except (ServiceLost, ServiceFailed):
            return dict.fromkeys(nodelets)
        answered = time.monotonic()

        def count(port: Any) -> Count:
            age = None if math.isnan(port.age) else port.age
            return Count(port.messages, asked, answered, port.latched, age)

        found: Counts = dict.fromkeys(nodelets)
        for each in answer.nodelets:
            if each.nodelet in found:
                out_ports = (port for port in each.ports if port.direction == Port.OUT)
                found[each.nodelet] = {port.port: count(port) for port in out_ports}
        return found


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
            return Count(self._messages, now, now, age=self._age)

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
            is_age_wanted, self._is_age_wanted = self._is_age_wanted, False
        if is_age_wanted:
            self._age = age_of_serialised(message)
