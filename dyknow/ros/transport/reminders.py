# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Has the master tell subscribers again of a topic that this process advertises once more.

A rospy subscriber does not connect to an address to which it has a connection, and it does not
connect again when that turns out to be closed. A subscriber whose callback takes long may learn
that a topic is back before it notices that the topic was gone; then it stays deaf for ever. The
master tells all subscribers of a topic whenever a node registers for it. To register again does
no harm to connected subscribers but may cost a message to one that is just connecting, so it is
done only for topics that were withdrawn lately, and only while a subscriber is missing.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from typing import Callable, Dict, FrozenSet, Optional

import rospy

from dyknow.backoff import Backoff
from dyknow.locks import state_lock
from dyknow.periodic import PeriodicWorker

#: Seconds in which every subscriber has noticed that a topic is gone.
LATELY = 60.0
#: Seconds until the first reminder; the pauses double.
_FIRST_PAUSE = 1.0
#: Seconds after which no more reminders are sent.
_GIVEN_UP_AFTER = 30.0
_STEP = 0.1

Addresses = FrozenSet[str]

#: Not below "rosout": to publish there rospy asks the master about a parameter first.
_log = logging.getLogger("dyknow.master")


@dataclass
class _Reminder:
    """A topic that is back.

    Attributes:
        datatype: its type.
        told: subscribers that know of it and may have yet to connect.
        until: when those that are still missing are given up.
    """

    datatype: str
    told: Addresses
    until: float


class Reminders:
    """Looks after topics that are back; its thread starts with the first of them."""

    def __init__(
        self,
        tell_again: Callable[[str, str], Optional[Addresses]],
        connected: Callable[[str], Addresses],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin without topics.

        Args:
            tell_again: registers a topic of a type again; returns the addresses of its
                subscribers, or None if that did not work.
            connected: addresses of the subscribers that are connected to a topic of this process.
            clock: seconds, steady.
        """
        self._tell_again = tell_again
        self._connected = connected
        self._clock = clock
        self._backoff = Backoff(clock, _FIRST_PAUSE, tolerated=0)
        self._state_lock = state_lock("reminders")
        self._withdrawn: Dict[str, float] = {}
        self._open: Dict[str, _Reminder] = {}
        self._worker = PeriodicWorker(
            "telling subscribers again",
            self._round,
            lambda: _STEP if self._open else None,
            _STEP,
            _log,
        )

    def withdrawn(self, topic: str) -> None:
        """Note that this process does not publish a topic any more."""
        now = self._clock()
        with self._state_lock:
            self._open.pop(topic, None)
            self._withdrawn = {
                each: when for each, when in self._withdrawn.items() if now - when < LATELY
            }
            self._withdrawn[topic] = now

    def advertised(self, topic: str, datatype: str, told: Addresses) -> None:
        """Note that this process publishes a topic, and which subscribers the master told."""
        now = self._clock()
        with self._state_lock:
            withdrawn = self._withdrawn.pop(topic, None)
            if not told or withdrawn is None or now - withdrawn >= LATELY:
                return
            self._open[topic] = _Reminder(datatype, told, now + _GIVEN_UP_AFTER)
        self._backoff.forgive(topic)
        self._backoff.failed(topic)
        self._worker.start()
        self._worker.wake()

    def look(self) -> None:
        """Send the reminders that are due."""
        now = self._clock()
        with self._state_lock:
            reminders = list(self._open.items())
        for topic, reminder in reminders:
            if not self._backoff.allows(topic):
                continue
            missing = reminder.told - self._connected(topic)
            if missing:
                told = self._tell_again(topic, reminder.datatype)
                reminder.told = missing if told is None else missing & told
            self._backoff.failed(topic)
            is_over = not missing or now >= reminder.until
            with self._state_lock:
                if is_over and self._open.get(topic) is reminder:
                    del self._open[topic]

    def _round(self) -> None:
        if not rospy.is_shutdown():
            self.look()
