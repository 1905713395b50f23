# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The connection that waits for a nodelet which moves here from another process.

It is connected while the nodelet still runs there, so both are sent the same messages. The other
process reports those that the nodelet received; they are left out here, even if they come late.
"""

from __future__ import annotations

import collections
import functools
from typing import Any, Callable, Counter, Sequence

from dyknow.nodelet.scheduler import message_lock
from dyknow.nodelet.streams.endpoints import Connection, Subscription

#: Seconds for which a message may be late here that the other process had received.
LATENESS = 3.0
_SKEW = 0.02  # seconds by which a message may come earlier there than here, at most


class ParkedConnection(Connection):
    """Holds messages for a subscription that is made later, beyond the size of its queue.

    ``subscription`` has the owner and the type of that one; ``digest`` returns the bytes by which
    a message is known in both processes.
    """

    __slots__ = tuple(
        "_began _digest _due _is_adopted _is_cleared _latched_before _made _until".split()
    )

    def __init__(
        self, subscription: Subscription, topic: str, digest: Callable[[Any], bytes]
    ) -> None:
        super().__init__(subscription, topic)
        self._digest = digest
        self._made = self._strand.clock()
        self._began = 0.0  # when its first message came; 0 before
        self._latched_before: list[Any] = []  # messages that came with the connection
        #: How often each message is yet to be left out, until a moment.
        self._due: Counter[bytes] = collections.Counter()
        self._until = 0.0
        #: Whether the messages are left out that the nodelet received in the other process.
        self._is_cleared = False
        self._is_adopted = False

    def adopt(self, subscription: Subscription, topic: str) -> bool:
        """Go over to a subscription if it is the one; returns whether it is.

        Before ``leave_out`` it is not: the nodelet has received some of these messages.
        """
        own = self.subscription
        wanted = (subscription.owner, subscription.datatype, topic)
        if (own.owner, own.datatype, self.topic) != wanted:
            return False
        with message_lock:
            if not self._is_cleared:
                return False
            self.subscription, self._strand = subscription, subscription.strand
            if own.converter is not None:
                subscription.convert(own.converter)
            self._latched_before.clear()
            self._is_adopted = True
        return True

    def push(self, message: Any) -> None:
        """Take a message from outside, unless the nodelet was given it already."""
        if not (self._due and self._is_due(message)):
            super().push(message)

    def push_locked(self, message: Any) -> None:
        if not self._began:
            self._began = self._strand.clock()
        super().push_locked(message)

    def push_latched(self, message: Any) -> None:
        if not self._is_adopted:
            self._latched_before.append(message)
        super().push_latched(message)

    def latest(self) -> list[tuple[float, bytes]]:
        """Return the last message of each publisher: its digest, with the present time.

        A message that a publisher sent because it latches, before any other, is not among them:
        the nodelet may have received it long ago.
        """
        with message_lock:
            held, now = list(self._queue), self._strand.clock()
            first = {latching(each): each for each in reversed(held) if latching(each)}
            self._latched_before += first.values()
            old = set(map(id, self._latched_before))
        last = {_header(each).get("callerid"): each for each in held if id(each) not in old}
        digests = map(self._digest_of, last.values())
        return [(now, digest) for digest in digests if digest is not None]

    def leave_out(
        self,
        given: Sequence[tuple[float, bytes]],
        waiting: Sequence[Any] = (),
        latched: Sequence[Any] = (),
    ) -> bool:
        """Drop the messages that the nodelet received in the other process, but for waiting ones.

        Messages that came there before this was made do not come here, so they do not count: equal
        ones may follow. Where messages are equal byte for byte, those that came before the first
        one here do not count either. Of each latching publisher the last message stays: the new
        instance needs it. The one that it had latched before, if any, is outdated then.

        ``given`` are digests with their times of arrival, by the same clock as here; messages that
        are ``waiting`` come before all others; ``latched`` are those of publications here. Returns
        False, and changes nothing, if the nodelet has the connection already.
        """
        often = collections.Counter(digest for _, digest in given)
        with message_lock:
            if self._is_adopted:
                return False
            self._is_cleared = False
            since = self._began - _SKEW
            self._until = self._strand.clock() + LATENESS
            self._due = collections.Counter(
                digest
                for time, digest in given
                if time >= self._made - _SKEW and (often[digest] == 1 or time >= since)
            )
            held = list(self._queue)
            self._queue.clear()
        from_outside = [each for each in held if latching(each)]
        latest = [*{latching(each): each for each in from_outside}.values(), *latched]
        old = set(map(id, self._latched_before)) - set(map(id, latest))
        there = set(map(self._digest_of, waiting)) - {None}
        again = {id(each) for each in latest if self._digest_of(each) in there}
        last = set(map(id, latest)) - again
        fresh = [
            each
            for each in held
            if not (self._is_due(each) or id(each) in old) or id(each) in last
        ]
        kept = [each for each in fresh if id(each) not in again]
        with message_lock:  # before the latest messages
            self._queue.extendleft(reversed([*waiting, *kept]))
            self._limit = max(self._limit, len(self._queue))  # a longer queue would have none
            self._is_cleared = True
        return True

    def open(self) -> None:
        """Deliver all that it holds; until then the queue has room for that too."""
        limit = self.subscription.queue_size or -1
        with message_lock:
            self._limit = limit + len(self._queue) if limit > 0 else limit
            super().open()
            if limit > 0:
                self._strand.post_locked(functools.partial(self._limit_to, limit))

    def _limit_to(self, limit: int) -> None:
        with message_lock:
            self._limit = limit
            while len(self._queue) > limit:
                self._queue.popleft()
                self.subscription.traffic.dropped += 1

    def _is_due(self, message: Any) -> bool:
        """Whether a message is to be left out, once for each time that it was given."""
        if self._strand.clock() > self._until:
            self._due = collections.Counter()
            return False
        digest = self._digest_of(message)
        if digest is None:
            return False
        with message_lock:
            if self._due[digest] < 1:
                return False
            self._due[digest] -= 1
            return True

    def _digest_of(self, message: Any) -> bytes | None:
        return digest_of(message, self._digest)


def digest_of(message: Any, digest: Callable[[Any], bytes]) -> bytes | None:
    """Return the digest of a message; None for one that came by reference and has none."""
    try:
        return digest(message)
    except Exception:  # its fields may be anything
        return None


def latching(message: Any) -> str:
    """Return the publisher of a message that rospy received, if that latches; else empty."""
    header = _header(message)
    return str(header.get("callerid", "?")) if header.get("latching") == "1" else ""


def _header(message: Any) -> dict[str, str]:
    return getattr(message, "_connection_header", None) or {}
