# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Threads that work in rounds, pools of threads, queues of events, and the clocks that they use.

A thread of DyKnow is one of three kinds: a `PeriodicWorker`, one of a pool (`Workers`), or a
single call in the background (`in_background`), for a call that may block for so long that it
would keep a pool from its work. All three have the same boundary: an exception of the work is
logged with its traceback, and the thread goes on.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import deque
from typing import Callable, Deque, Generic, Optional, TypeVar, Union

from dyknow.errors import DyKnowError
from dyknow.locks import state_condition, state_lock

#: Least seconds between two rounds of a worker, however often it is woken.
PAUSE = 0.05
#: Seconds until a round that failed is repeated.
RETRY = 0.5
#: Seconds between two ticks of a running clock.
_TICK = 0.1
#: Seconds that count at most between two of its readings; longer gaps are pauses of the process.
LONGEST_TICK = 0.3

T = TypeVar("T")
Event = TypeVar("Event")
Period = Union[None, float, Callable[[], Optional[float]]]
"""Seconds between two rounds, None for no round before the worker is woken, or a function that
returns one of these."""

_log = logging.getLogger("rosout.dyknow")


class Clock:
    """Steady time, in seconds."""

    def now(self) -> float:
        """Return the time."""
        return time.monotonic()

    def wait(self, condition: threading.Condition, seconds: Optional[float]) -> None:
        """Wait for a condition, whose lock is held, to be notified; at most ``seconds``."""
        condition.wait(seconds)


STEADY = Clock()


def attempt(what: str, work: Callable[[], T], logger: logging.Logger = _log) -> Optional[T]:
    """Call ``work`` at the top of a thread; None if it raised, which is logged.

    Args:
        what: what the work is, for the log.
        work: the call.
        logger: where a failure is logged.
    """
    try:
        return work()
    except DyKnowError as error:
        logger.warning("%s: %s", what, error)
    except Exception:  # the boundary of the thread
        logger.exception("%s failed", what)
    return None


def in_background(
    what: str, work: Callable[[], object], logger: logging.Logger = _log
) -> threading.Thread:
    """Call ``work`` in a daemon thread of its own, which is returned.

    Args:
        what: what the work is, for the log and as the name of the thread.
        work: the call.
        logger: where a failure is logged.
    """
    thread = threading.Thread(target=attempt, args=(what, work, logger), name=what, daemon=True)
    thread.start()
    return thread


class PeriodicWorker:
    """One daemon thread, one round at a time. Every method is safe from any thread.

    A round that fails is logged, and repeated after ``RETRY`` seconds.
    """

    def __init__(
        self,
        what: str,
        work: Callable[[], object],
        period: Period = None,
        pause: float = PAUSE,
        logger: logging.Logger = _log,
        clock: Clock = STEADY,
    ) -> None:
        """Prepare; ``start`` starts the thread.

        Args:
            what: what a round does, for the log and as the name of the thread.
            work: a round. It may close its own worker.
            period: seconds to the next round; a function is asked after each round.
            pause: least seconds to the next round.
            logger: where failures are logged.
            clock: steady time.
        """
        self._what = what
        self._work = work
        self._period = period
        self._pause = pause
        self._logger = logger
        self._clock = clock
        self._changed = state_condition("worker")
        #: Numbers of the last round that began, that ended, and that somebody asked for.
        self._begun = self._ended = self._wanted = 0
        self._closed = False
        self._thread: Optional[threading.Thread] = None

    @property
    def running(self) -> bool:
        """Whether its thread was started and has not ended."""
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Start the thread, unless it runs or the worker is closed.

        The first round comes after a period, or when the worker is woken.
        """
        with self._changed:
            if self._thread is None and not self._closed:
                self._thread = in_background(self._what, self._run, self._logger)

    def wake(self) -> int:
        """Ask for a round that begins from now on, and return its number; does not wait."""
        with self._changed:
            self._wanted = self._begun + 1
            self._changed.notify_all()
            return self._wanted

    def wait_for(self, number: int, timeout: float) -> bool:
        """Wait for the end of a round, as ``wake`` numbers them; returns whether it has ended.

        A worker that is closed finishes the round that is running, and begins no other.

        Args:
            number: the round.
            timeout: seconds to wait at most.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self._ended >= number or (self._closed and self._begun < number), timeout
            )
            return self._ended >= number

    def close(self, timeout: float = 0.0) -> None:
        """Begin no further round; wait at most ``timeout`` s for the end of the thread."""
        with self._changed:
            self._closed = True
            thread = self._thread
            self._changed.notify_all()
        if thread is not None and thread is not threading.current_thread():
            thread.join(timeout)

    def _run(self) -> None:
        while not self._closed:
            if attempt(self._what, self._round, self._logger) is None:
                self._sleep(RETRY, woken=False)
                self.wake()

    def _round(self) -> bool:
        period = self._period() if callable(self._period) else self._period
        self._sleep(self._pause, woken=False)
        self._sleep(None if period is None else period - self._pause, woken=True)
        with self._changed:
            if self._closed:
                return False
            self._begun += 1
        try:
            self._work()
        finally:
            with self._changed:
                self._ended = self._begun
                self._changed.notify_all()
        return True

    def _sleep(self, seconds: Optional[float], woken: bool) -> None:
        """Sleep until the worker is closed or, where ``woken`` says so, woken."""
        deadline = None if seconds is None else self._clock.now() + seconds
        with self._changed:
            while not self._closed and not (woken and self._wanted > self._begun):
                left = None if deadline is None else deadline - self._clock.now()
                if left is not None and left <= 0.0:
                    return
                self._clock.wait(self._changed, left)


class Workers:
    """A few daemon threads on one queue, first in, first out."""

    def __init__(self, what: str, count: int) -> None:
        """Start ``count`` threads, with the name of their work for the log."""
        self._what = what
        self._queue: queue.SimpleQueue[Optional[Callable[[], object]]] = queue.SimpleQueue()
        self._closed = False
        self._threads = [in_background(f"{what} {n}", self._run) for n in range(count)]

    def run(self, work: Callable[[], object]) -> None:
        """Call ``work`` soon; does not wait for it."""
        self._queue.put(work)

    def close(self, timeout: float = 0.0) -> None:
        """Start no further work; wait at most ``timeout`` s for running work."""
        self._closed = True
        for _ in self._threads:
            self._queue.put(None)
        deadline = time.monotonic() + timeout
        for thread in self._threads:
            thread.join(max(0.0, deadline - time.monotonic()))

    def _run(self) -> None:
        while True:
            work = self._queue.get()
            if work is None or self._closed:
                return
            attempt(self._what, work)


class EventQueue(Generic[Event]):
    """Passes events to a listener, one at a time and in order, outside the locks of the sender.

    Safe from any thread.
    """

    def __init__(self, listener: Callable[[Event], None]) -> None:
        """Start empty; ``listener`` is called with each event."""
        self.listener = listener
        self._state_lock = state_lock("event queue")
        self._events: Deque[Event] = deque()
        self._delivering = False

    def add(self, event: Event) -> None:
        """Append an event; called under the lock that decides the order."""
        with self._state_lock:
            self._events.append(event)

    def deliver(self) -> None:
        """Pass all events to the listener, unless another thread does; called under no lock."""
        while True:
            with self._state_lock:
                if self._delivering or not self._events:
                    return
                event = self._events.popleft()
                self._delivering = True
            try:
                self.listener(event)
            finally:
                with self._state_lock:
                    self._delivering = False


class RunningClock:
    """Seconds for which this process has run; safe from any thread.

    A process that was stopped has received no messages meanwhile, so the silence of its peers
    means nothing. By this clock they still have their time to answer when the process goes on.
    """

    def __init__(self, steady: Callable[[], float] = time.monotonic) -> None:
        """Start at 0; it stands still between readings that are far apart.

        Args:
            steady: steady time, in seconds.
        """
        self._steady = steady
        self._state_lock = state_lock("running clock")
        self._last = steady()
        self._run = 0.0

    def __call__(self) -> float:
        """Return the time."""
        with self._state_lock:
            now = self._steady()
            self._run += min(now - self._last, LONGEST_TICK)
            self._last = now
            return self._run

    @classmethod
    def started(cls) -> RunningClock:
        """Return a clock that a thread keeps going for as long as the process runs."""
        clock = cls()
        PeriodicWorker("the clock of this process", clock, _TICK).start()
        return clock
