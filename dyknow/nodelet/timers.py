"""Timers of all nodelets on one thread, which sleeps until the next one is due.

The thread only posts to the timer's strand, so a slow callback delays nobody else. A timer whose
callback has not run yet is not queued a second time, as in roscpp.
"""

from __future__ import annotations

import heapq
import itertools
import logging
import threading
from typing import Any, Callable, List, Optional, Tuple

from dyknow.nodelet.middleware import Middleware
from dyknow.nodelet.scheduler import Strand

_log = logging.getLogger("rosout.dyknow")


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
    ) -> None:
        self.period = period
        self.oneshot = oneshot
        self.due = 0.0
        self._queue = queue
        self._callback = callback
        self.strand = strand
        self._failed = failed
        self._pending = threading.Lock()
        self._done = False
        self._last: Any = None
        self._took: Optional[float] = None

    def is_alive(self) -> bool:
        """Whether it will call back again."""
        return not self._done

    def shutdown(self) -> None:
        """Call back no more; a callback that runs is not waited for."""
        self._done = True
        self._queue.discard(self)

    def fire(self) -> None:
        """Queue the callback, unless the last one still waits."""
        if not self._done and self._pending.acquire(False):
            due = self.due
            self.strand.post(lambda: self._call(due))

    def _call(self, due: float) -> None:
        self._pending.release()
        if self._done:
            return
        middleware, now = self._queue.middleware, self._queue.now
        start = now()
        event = middleware.timer_event(self._last, due, start, self._took)
        self._last = event
        if self.oneshot:
            self._done = True
        try:
            self._callback(event)
        except BaseException as error:  # the boundary, as for subscriptions
            self._failed(error)
        self._took = now() - start


class TimerQueue:
    """All timers, soonest first; its thread starts with the first timer."""

    def __init__(self, middleware: Middleware) -> None:
        self.middleware = middleware
        self.now = middleware.ticker.now
        self._ticker = middleware.ticker
        self._lock = threading.Lock()
        self._order = itertools.count()
        self._heap: List[Tuple[float, int, Timer]] = []
        self._thread: Optional[threading.Thread] = None
        self._closed = False

    def add(
        self,
        period: float,
        callback: Callable[[Any], None],
        strand: Strand,
        oneshot: bool,
        failed: Callable[[BaseException], None],
    ) -> Timer:
        """Start a timer with a period in seconds.

        Raises:
            ValueError: the period is not positive.
        """
        if not period > 0.0:
            raise ValueError(f"the period of a timer must be positive, not {period}")
        timer = Timer(self, period, callback, strand, oneshot, failed)
        timer.due = self.now() + period
        with self._lock:
            heapq.heappush(self._heap, (timer.due, next(self._order), timer))
            if self._thread is None and not self._closed:
                self._thread = threading.Thread(
                    target=self._run, name="dyknow-timers", daemon=True
                )
                self._thread.start()
        self._ticker.wake()
        return timer

    def discard(self, timer: Timer) -> None:
        """Forget a timer."""
        with self._lock:
            self._heap = [entry for entry in self._heap if entry[2] is not timer]
            heapq.heapify(self._heap)
        self._ticker.wake()

    def close(self) -> None:
        """Forget all timers and end the thread."""
        with self._lock:
            self._closed = True
            self._heap = []
        self._ticker.wake()

    def tick(self) -> Optional[float]:
        """Fire what is due; returns when the next timer is."""
        now = self.now()
        due: List[Timer] = []
        with self._lock:
            while self._heap and self._heap[0][0] <= now:
                timer = heapq.heappop(self._heap)[2]
                due.append(timer)
            for timer in due:
                if not timer.oneshot:
                    # Due on its grid, but never in a burst to catch up what was slept through.
                    missed = max(0, int((now - timer.due) / timer.period))
                    following = timer.due + (missed + 1) * timer.period
                    heapq.heappush(self._heap, (following, next(self._order), timer))
        for timer in due:
            timer.fire()
        with self._lock:
            for entry in self._heap:
                entry[2].due = entry[0]
            self._rewind(now)
            return self._heap[0][0] if self._heap else None

    def _rewind(self, now: float) -> None:
        # Simulated time went back: wait one period from there, not for the old future.
        if any(due > now + timer.period for due, _, timer in self._heap):
            self._heap = [
                (min(due, now + timer.period), order, timer) for due, order, timer in self._heap
            ]
            heapq.heapify(self._heap)
            for due, _, timer in self._heap:
                timer.due = due

    def _run(self) -> None:
        while not self._closed:
            try:
                self._ticker.wait(self.tick())
            except Exception:  # the boundary of the thread: timers of others must go on
                _log.exception("the timer thread goes on after an error")
