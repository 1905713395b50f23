# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a topic owes to subscribers that were told of it and have yet to connect.

A publisher that moves to a topic waits for its subscribers, but not for ever. What it sends
before the last of them has connected is kept for a while and handed to each that comes late, so a
busy machine delays a stream and does not tear it.
"""

from __future__ import annotations

import collections
import time
from typing import Any, Callable, Collection, Deque, List, Set

#: Seconds in which a subscriber that the master told of a publisher has connected, if it lives.
LONGEST = 10.0
#: Messages kept at most where the publisher's own queue is unbounded.
_MOST = 1000


class Backlog:
    """Subscribers that are on their way to one topic, and what they have missed.

    All methods but ``waiting`` are called under the lock of rospy's publisher.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._due: Set[str] = set()
        self._deadline = 0.0
        self._missed: Deque[Any] = collections.deque()
        #: Whether a subscriber is expected; looked at on every publish.
        self.open = False

    def expect(self, due: Collection[str], size: int) -> None:
        """Begin to keep messages.

        Args:
            due: addresses of the nodes that were told of the publisher and have yet to connect.
            size: messages to keep, the newest; 0 for no bound of the publisher's own.
        """
        self._due = set(due)
        self._missed = collections.deque(maxlen=size or _MOST)
        self._deadline = self._clock() + LONGEST
        self.open = bool(self._due)

    def waiting(self) -> bool:
        """Whether a subscriber is still expected."""
        if self.open and self._clock() >= self._deadline:
            self._close()
        return self.open

    def keep(self, message: Any) -> None:
        """Keep a message for subscribers that are late."""
        if self.waiting():
            self._missed.append(message)

    def greet(self, address: str) -> List[Any]:
        """Return what a subscriber missed that has connected now, oldest first."""
        if not self.waiting() or address not in self._due:
            return []
        self._due.remove(address)
        missed = list(self._missed)
        if not self._due:
            self._close()
        return missed

    def _close(self) -> None:
        self.open = False
        self._missed.clear()
