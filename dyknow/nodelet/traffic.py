# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Counts of what went through one end of a stream, cheap enough for every message."""

from __future__ import annotations

from dyknow.nodelet.scheduler import Clock

#: A rate is taken over the last one to two stretches of so many messages, so that it follows.
_STRETCH = 32


class Traffic:
    """Running counts; ``sent`` and ``received`` are called by one thread at a time.

    They are called for every message of every port, mostly with cold caches, so they touch as
    little memory as they can: no window of time stamps is kept, only where two stretches began.

    Attributes:
        messages: sent or received.
        dropped: refused by a full queue, or published while disconnected.
        busy: seconds that callbacks took.
        longest: seconds that the longest of them took.
    """

    __slots__ = (
        "_before",
        "_begin",
        "_clock",
        "_last",
        "busy",
        "dropped",
        "longest",
        "messages",
    )

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._last = 0.0
        #: Number and time of the first message of this stretch and of the one before.
        self._begin = self._before = (0, 0.0)
        self.messages = 0
        self.dropped = 0
        self.busy = 0.0
        self.longest = 0.0

    def sent(self) -> None:
        """Count one message that goes out now."""
        self.messages = number = self.messages + 1
        self._last = now = self._clock()
        if number % _STRETCH == 1:
            self._begin_stretch(number, now)

    def received(self, start: float, took: float) -> None:
        """Count one message whose callback began at ``start`` and ``took`` so many seconds."""
        self.messages = number = self.messages + 1
        self._last = start
        self.busy += took
        if took > self.longest:
            self.longest = took
        if number % _STRETCH == 1:
            self._begin_stretch(number, start)

    def _begin_stretch(self, number: int, now: float) -> None:
        self._before = self._begin if number > 1 else (1, now)
        self._begin = (number, now)

    def rate(self) -> float:
        """Return Hz over the last messages; 0 for less than two, falling while none come."""
        number, last, (first, since) = self.messages, self._last, self._before
        intervals = number - first
        if intervals < 1 or first == 0:
            return 0.0
        span = last - since
        silence = self._clock() - last
        # Until one is overdue the rate is that of the stretch; then the silence counts with it.
        if silence > 2 * span / intervals:
            span += silence
        return intervals / span if span > 0 else 0.0
