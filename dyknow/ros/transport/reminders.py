"""Has the master tell subscribers again of a topic that this process advertises once more.

A rospy subscriber does not connect to an address to which it has a connection, and it does not
connect again when that turns out to be closed. So one that is told that a topic is back before it
has noticed that it was gone, since a callback of it takes its time, stays deaf for ever. The
master tells all subscribers of a topic whenever somebody registers for it; registering again is
harmless for those that are connected, but may cost those that are just connecting a message, so
it is done only for topics that were withdrawn lately, and only while somebody is missing.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from typing import Callable, Dict, FrozenSet, Optional

import rospy

from dyknow.locks import state_lock
from dyknow.periodic import PeriodicWorker

#: Seconds in which a subscriber notices that a topic is gone, at the most.
LATELY = 60.0
#: Seconds until the first reminder; the pauses double up to the longest.
_FIRST_PAUSE = 1.0
_LONGEST_PAUSE = 32.0
_STEP = 0.1

Addresses = FrozenSet[str]

#: Not below "rosout": to publish there rospy asks the master about a parameter first.
_log = logging.getLogger("dyknow.master")


@dataclass
class _Reminder:
    """Those who were told of a topic, and when to look who of them has not come."""

    datatype: str
    told: Addresses
    due: float
    pause: float = _FIRST_PAUSE


class Reminders:
    """Looks after topics that came back; its thread starts with the first of them."""

    def __init__(
        self,
        tell_again: Callable[[str, str], Optional[Addresses]],
        connected: Callable[[str], Addresses],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Look after nothing yet.

        Args:
            tell_again: registers a topic of a type again; returns who subscribes to it, or None
                if that did not work.
            connected: addresses of those that are connected to a topic of this process.
            clock: seconds, steady.
        """
        self._tell_again = tell_again
        self._connected = connected
        self._clock = clock
        self._lock = state_lock("reminders")
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
        with self._lock:
            self._open.pop(topic, None)
            self._withdrawn = {
                each: when for each, when in self._withdrawn.items() if now - when < LATELY
            }
            self._withdrawn[topic] = now

    def advertised(self, topic: str, datatype: str, told: Addresses) -> None:
        """Note that this process publishes a topic, and whom the master told of it."""
        now = self._clock()
        with self._lock:
            withdrawn = self._withdrawn.pop(topic, None)
            if not told or withdrawn is None or now - withdrawn >= LATELY:
                return
            self._open[topic] = _Reminder(datatype, told, now + _FIRST_PAUSE)
        self._worker.start()
        self._worker.wake()

    def look(self) -> None:
        """Remind those who are due."""
        now = self._clock()
        with self._lock:
            due = [(topic, each) for topic, each in self._open.items() if each.due <= now]
        for topic, reminder in due:
            missing = reminder.told - self._connected(topic)
            if missing:
                told = self._tell_again(topic, reminder.datatype)
                reminder.told = missing if told is None else missing & told
            reminder.due, reminder.pause = now + reminder.pause, 2 * reminder.pause
            is_over = not missing or reminder.pause > _LONGEST_PAUSE
            with self._lock:
                if is_over and self._open.get(topic) is reminder:
                    del self._open[topic]

    def _round(self) -> None:
        if not rospy.is_shutdown():
            self.look()
