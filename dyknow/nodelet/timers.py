# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Timers of all nodelets on one thread, which sleeps until the next one is due.

The thread only posts to the timer's strand, so a slow callback delays no other timer. A timer
whose callback has not run yet is not queued a second time, as in roscpp. Waking up costs most, so
timers that are due shortly after each other are fired together, at most two milliseconds late.
Where simulated time has not begun, periods are counted from its first moment, as in rospy.
"""

from __future__ import annotations

import heapq
import itertools
import logging
import math
import sys
import threading
from typing import Any, Callable

from dyknow.locks import flag_lock, state_lock
from dyknow.nodelet.middleware import Ticker
from dyknow.nodelet.scheduler import Strand

_log = logging.getLogger("rosout.dyknow")


_PART_OF_PERIOD = 0.1  # largest part of the shortest period that the ticker's pause may be
_FIRST_MOMENT = sys.float_info.min  # when simulated time begins: at any moment after 0


class Timer:
    """Calls back with a period, or once, until ``shutdown``; made by ``NodeHandle.Timer``."""

    def __init__(
        self,
        queue: TimerQueue,
        period: float,
        callback: Callable[[Any], None],
        strand: Strand,
        oneshot: bool,
        failed: Callable[[BaseException], None],
        spend: Callable[[float], None],
    ) -> None:
        """Make a timer; ValueError if its period, in seconds, is not positive.

        ``spend`` is called with the seconds of steady time that each callback took.
        """
        if not period > 0.0:
            raise ValueError(f"the period of a timer must be positive, not {period}")
        self.period = period
        self.oneshot = oneshot
        self._queue = queue
        self._callback = callback
        self.strand = strand
        self._failed = failed
        self._spend = spend
        self._pending = flag_lock()
        self._done = False
        self._last: Any = None
        self._took: float | None = None

    def is_alive(self) -> bool:
        """Whether it will call back again."""
        return not self._done

    def shutdown(self) -> None:
        """Stop the calls; a running callback is not waited for."""
        self._done = True
        self._queue.discard(self)
        self._let_go()

    def fire(self, due: float) -> None:
        """Queue the callback that is due then, unless the last one still waits."""
        if not self._done and self._pending.acquire(False):
            self.strand.post(lambda: self._call(due))

    def _call(self, due: float) -> None:
        self._pending.release()
        if self._done:
            return
        ticker = self._queue.ticker
        start = ticker.now()
        began = self.strand.clock()
        event = ticker.event(self._last, due, start, self._took)
        self._last = event
        callback = self._callback
        if self.oneshot:
            self._done = True
            self._let_go()
        try:
            callback(event)
        except BaseException as error:  # the boundary, as for subscriptions
            self._failed(error)
        self._took = self.strand.clock() - began
        self._spend(self._took)

    def _let_go(self) -> None:
        """Drop the callback at the end: it refers to the nodelet, and mostly that to the timer."""
        self._callback = _ignore


class TimerQueue:
    """All timers, soonest first; its thread starts with the first timer."""

    def __init__(self, ticker: Ticker) -> None:
        self.ticker = ticker
        self._lock = state_lock("timers")
        self._order = itertools.count()
        self._heap: list[tuple[float, int, Timer]] = []
        self._pause = ticker.pause
        self._latest = 0.0  # time that was seen; less shows that it went back
        self._awaits_time = False  # some are due never, until time begins
        self._thread: threading.Thread | None = None
        self._closed = False

    def add(self, timer: Timer) -> None:
        now = self.ticker.now()
        with self._lock:
            self._latest = max(self._latest, now)
            if self._thread is None and not self._closed:
                thread = threading.Thread(target=self._run, name="dyknow-timers", daemon=True)
                thread.start()  # which the system may refuse: then there is no such timer
                self._thread = thread
            has_begun = self.ticker.has_begun(now)
            self._awaits_time = self._awaits_time or not has_begun
            due = now + timer.period if has_begun else math.inf
            heapq.heappush(self._heap, (due, next(self._order), timer))
            self._pause = min(self._pause, _pause(timer))
        self.ticker.wake()

    def discard(self, timer: Timer) -> None:
        with self._lock:
            self._heap = [entry for entry in self._heap if entry[2] is not timer]
            heapq.heapify(self._heap)
            self._pause = min([self.ticker.pause, *(_pause(entry[2]) for entry in self._heap)])
        self.ticker.wake()

    def close(self) -> None:
        """Forget all timers and end the thread."""
        with self._lock:
            self._closed = True
            self._heap = []
        self.ticker.wake()

    def tick(self) -> float | None:
        """Fire the timers that are due; returns when the next one is."""
        now = self.ticker.now()
        fired: list[tuple[Timer, float]] = []
        with self._lock:
            if now < self._latest or self._awaits_time:
                self._begin_again(now)
            self._latest = now
            while self._heap and self._heap[0][0] <= now:
                due, _, timer = heapq.heappop(self._heap)
                fired.append((timer, due))
            for timer, due in fired:
                if not timer.oneshot:
                    # Due on its grid, but never in a burst to catch up with missed calls.
                    missed = int((now - due) / timer.period)
                    following = due + (missed + 1) * timer.period
                    heapq.heappush(self._heap, (following, next(self._order), timer))
        for timer, due in fired:
            timer.fire(due)
        with self._lock:
            if self._awaits_time:
                return _FIRST_MOMENT
            return max(self._heap[0][0], now + self._pause) if self._heap else None

    def _begin_again(self, now: float) -> None:
        """Wait one period from now, where simulated time has begun or went back.

        At 0 it is to begin again: then wait for that, not for the old future.
        """
        self._awaits_time = not self.ticker.has_begun(now)
        self._heap = [
            (math.inf if self._awaits_time else min(due, now + timer.period), order, timer)
            for due, order, timer in self._heap
        ]
        heapq.heapify(self._heap)

    def _run(self) -> None:
        while not self._closed:
            try:
                self.ticker.wait(self.tick())
            except Exception:  # the boundary of the thread: the other timers must go on
                _log.exception("the timer thread goes on after an error")


def _ignore(event: Any) -> None:
    """Do nothing."""


def _pause(timer: Timer) -> float:
    """Seconds by which a timer may be late; once late, a single call is not missed."""
    return math.inf if timer.oneshot else _PART_OF_PERIOD * timer.period
