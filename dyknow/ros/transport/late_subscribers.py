# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Subscribers that know of a publisher of this process and have yet to connect.

A publisher that moves to a topic waits for its subscribers, but not for ever. `Backlog` keeps its
messages until the last of them has connected, and delivers them to each that comes late. So a
busy machine delays a stream and does not tear it.

A rospy subscriber does not connect to an address to which it has a connection, and it does not
connect again when that turns out to be closed. A subscriber whose callback takes long may learn
that a topic is back before it notices that the topic was gone; then it stays deaf for ever. The
master notifies all subscribers of a topic whenever a node registers for it. To register again does
no harm to connected subscribers but may cost a message to one that is just connecting, so
`Reminders` does it only for topics that were withdrawn lately, while a subscriber is missing.
"""

from __future__ import annotations

import collections
import logging
import time
from dataclasses import dataclass
from typing import Any, Callable, Collection, FrozenSet

import rospy

from dyknow.locks import state_lock
from dyknow.periodic import PeriodicWorker

#: Seconds in which a subscriber that the master notified has connected, if it lives.
LONGEST = 10.0
#: Seconds before it is looked for the first time whether it has left the topic; then they double.
_FIRST_LOOK = 0.5
#: Seconds for which a subscriber that did not connect in time is not waited for again.
_IMPATIENCE = 5.0
#: Messages kept at most where the publisher's own queue is unbounded.
_MOST = 1000
#: Seconds in which every subscriber has noticed that a topic is gone.
LATELY = 60.0
#: Seconds before the first reminder: one that is only busy answers within them, as a rule.
_PATIENCE = 2.0
#: The pauses after it double, from the first to the last.
_FIRST_PAUSE, _LAST_PAUSE = 1.0, 16.0
_STEP = 0.1

Addresses = FrozenSet[str]
Clock = Callable[[], float]

#: Not below "rosout": to publish there rospy asks the master about a parameter first.
_log = logging.getLogger("dyknow.master")


class Backlog:
    """Subscribers that are about to connect to one topic, and the messages that they missed.

    All methods but ``waiting`` are called under the lock of rospy's publisher.

    A node that was killed stays registered with the master, so a subscriber that is expected may
    be dead. One may leave before it connects, and come back: what was published meanwhile is not
    for it.
    """

    def __init__(self, clock: Clock = time.monotonic) -> None:
        self._clock = clock
        #: Addresses of the subscribers that are expected; replaced by each change.
        self.due: Addresses = frozenset()
        self._deadline = 0.0
        self._missed: collections.deque[Any] = collections.deque()
        #: Whether a subscriber is expected; looked at on every publish.
        self.open = False
        #: Called when a message is not kept, since the subscribers have not come in time.
        self.gave_up: Callable[[], None] = lambda: None
        #: Called now and then when a message is kept: some subscribers may have left.
        self.look: Callable[[], None] = lambda: None
        self._look_at = self._pause = 0.0

    def expect(self, due: Collection[str], size: int) -> None:
        """Keep the newest ``size`` messages from now on; 0 for no bound of the publisher's own.

        ``due``: addresses of the nodes that know of the publisher and have yet to connect.
        """
        self.due = frozenset(due)
        self._missed = collections.deque(maxlen=size or _MOST)
        now = self._clock()
        self._deadline = now + LONGEST
        self._pause = _FIRST_LOOK
        self._look_at = now + self._pause
        self.open = bool(self.due)

    def widen(self, size: int) -> None:
        """Keep so many messages from now on, if that is more; 0 for no bound."""
        if self.open and (size or _MOST) > (self._missed.maxlen or 0):
            self._missed = collections.deque(self._missed, size or _MOST)

    def waiting(self) -> bool:
        """Whether a subscriber is still expected."""
        if self.open and self._clock() >= self._deadline:
            self._close()
        return self.open

    def keep(self, message: Any) -> None:
        if self.open:
            if self.waiting():
                self._missed.append(message)
                now = self._clock()
                if now >= self._look_at:
                    self._pause *= 2
                    self._look_at = now + self._pause
                    self.look()
            else:
                self.gave_up()

    def missed_by(self, address: str) -> list[Any]:
        """Return the messages that an expected subscriber has missed by now, oldest first."""
        return list(self._missed) if self.waiting() and address in self.due else []

    def forget(self, addresses: Collection[str]) -> None:
        """Expect these subscribers no more."""
        self.due = self.due.difference(addresses)
        if not self.due:
            self._close()

    def _close(self) -> None:
        self.open = False
        self._missed.clear()


class LateSubscribers:
    """Addresses of nodes that did not connect in time lately, hung ones mostly; for any thread.

    Each topic of a node that hangs, or whose host is away, would be waited for in vain else.
    """

    def __init__(self, clock: Clock = time.monotonic) -> None:
        self._clock = clock
        self._until: dict[str, float] = {}

    def note(self, addresses: Collection[str]) -> None:
        now = self._clock()
        known = {each: until for each, until in self._until.items() if now < until}
        self._until = {**known, **dict.fromkeys(addresses, now + _IMPATIENCE)}

    def without(self, addresses: Collection[str]) -> Addresses:
        """Return those of addresses that are worth a wait."""
        now = self._clock()
        return frozenset(each for each in addresses if now >= self._until.get(each, 0.0))


@dataclass
class _Reminder:
    """A topic that is advertised again."""

    datatype: str
    due: Addresses  # of subscribers that know of it and may have yet to connect
    at: float
    pause: float = _FIRST_PAUSE


class Reminders:
    """Reminds subscribers of topics that are back; the thread starts with the first topic.

    Args:
        register_again: registers a topic of a type again; returns the addresses of its
            subscribers, or None if that did not work.
        connected: addresses of the subscribers that are connected to a topic of this process.
        clock: seconds, steady.
    """

    def __init__(
        self,
        register_again: Callable[[str, str], Addresses | None],
        connected: Callable[[str], Addresses],
        clock: Clock = time.monotonic,
    ) -> None:
        self._register_again = register_again
        self._connected = connected
        self._clock = clock
        self._state_lock = state_lock("reminders")
        self._withdrawn: dict[str, float] = {}
        self._open: dict[str, _Reminder] = {}
        self._worker = PeriodicWorker(
            "reminding subscribers",
            self.remind,
            lambda: _STEP if self._open else None,
            _STEP,
            _log,
        )

    def withdrawn(self, topic: str) -> None:
        """Note that this process does not publish a topic any more."""
        now = self._clock()
        with self._state_lock:
            self._open.pop(topic, None)
            lately = ((each, at) for each, at in self._withdrawn.items() if now - at < LATELY)
            self._withdrawn = {**dict(lately), topic: now}

    def advertised(self, topic: str, datatype: str, notified: Addresses) -> None:
        """Note that this process publishes a topic, and which subscribers the master notified."""
        now = self._clock()
        with self._state_lock:
            withdrawn = self._withdrawn.pop(topic, None)
            if not notified or withdrawn is None or now - withdrawn >= LATELY:
                return
            self._open[topic] = _Reminder(datatype, notified, now + _PATIENCE)
        self._worker.start()
        self._worker.wake()

    def remind(self) -> None:
        """Send the reminders that are due."""
        if rospy.is_shutdown():
            return
        now = self._clock()
        with self._state_lock:
            due = [(topic, each) for topic, each in self._open.items() if now >= each.at]
        for topic, reminder in due:
            missing = reminder.due - self._connected(topic)
            if missing:
                notified = self._register_again(topic, reminder.datatype)
                reminder.due = missing if notified is None else missing & notified
            is_over = not missing or reminder.pause >= _LAST_PAUSE
            reminder.pause *= 2
            reminder.at = now + reminder.pause
            with self._state_lock:
                if is_over and self._open.get(topic) is reminder:
                    del self._open[topic]
