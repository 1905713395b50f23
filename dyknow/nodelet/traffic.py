"""Counts of what went through one end of a stream, cheap enough for every message."""

from __future__ import annotations

import collections
from dataclasses import dataclass
from typing import Deque

from dyknow.nodelet.scheduler import Clock

#: Messages over which a rate is taken, as in ``rostopic hz`` but fewer, so that it follows.
_WINDOW = 64


@dataclass(frozen=True)
class TrafficSnapshot:
    """Traffic at one moment.

    Attributes:
        messages: sent or received since the start.
        dropped: refused by a full queue, or published while disconnected.
        rate: Hz over the last messages; 0 for less than two, falling while nothing comes.
        mean_callback: seconds a callback takes on average; 0 for publications.
        max_callback: seconds of the longest callback.
    """

    messages: int = 0
    dropped: int = 0
    rate: float = 0.0
    mean_callback: float = 0.0
    max_callback: float = 0.0


class Traffic:
    """Running counts; ``sent`` and ``received`` are called by one thread at a time."""

    __slots__ = ("_busy", "_clock", "_longest", "_stamps", "dropped", "messages")

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._stamps: Deque[float] = collections.deque(maxlen=_WINDOW)
        self._busy = 0.0
        self._longest = 0.0
        self.messages = 0
        self.dropped = 0

    def sent(self) -> None:
        """Count one message that goes out now."""
        self.messages += 1
        self._stamps.append(self._clock())

    def received(self, start: float, took: float) -> None:
        """Count one message whose callback began at ``start`` and ``took`` so many seconds."""
        self.messages += 1
        self._stamps.append(start)
        self._busy += took
        if took > self._longest:
            self._longest = took

    def snapshot(self) -> TrafficSnapshot:
        """Values for the reader, who may be any thread."""
        messages = self.messages
        return TrafficSnapshot(
            messages=messages,
            dropped=self.dropped,
            rate=self._rate(),
            mean_callback=self._busy / messages if messages else 0.0,
            max_callback=self._longest,
        )

    def _rate(self) -> float:
        stamps = self._stamps.copy()
        if len(stamps) < 2:
            return 0.0
        span = stamps[-1] - stamps[0]
        silence = self._clock() - stamps[-1]
        period = span / (len(stamps) - 1)
        # Until one is overdue the rate is that of the window; then the silence counts with it.
        if silence > 2 * period:
            span += silence
        return (len(stamps) - 1) / span if span > 0 else 0.0
