# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Threads that work in rounds, queues of events, and the clocks that they use.

A thread of DyKnow is one of a `ControlLoop`, or a single call in the background (`in_background`)
that may block for long. Both have the same boundary: an exception of the work is logged with its
traceback, and the thread goes on.
"""

from __future__ import annotations

import gc
import itertools
import logging
import math
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from types import FrameType
from typing import Callable, Generic, Iterator, Optional, TypeVar, Union, cast

from dyknow.errors import DyKnowError
from dyknow.locks import reentrant_state_lock, state_condition, state_lock

PAUSE = 0.05  # least seconds between two rounds of a key, however often it is woken
RETRY = 0.5  # seconds until a round that failed is repeated
_TICK = 0.1  # seconds between two ticks of a running clock
#: Seconds that count at most between two of its readings; longer gaps are pauses of the process.
LONGEST_TICK = 0.3

#: Raised by the start of a thread that the system refuses: at ``ulimit -u`` or ``pids.max``.
NO_THREAD = (RuntimeError, MemoryError)

T = TypeVar("T")
Work = Callable[[], Optional[float]]
Event = TypeVar("Event")
Period = Union[None, float, Callable[[], Optional[float]]]
"""Seconds between two rounds, None for no round before the worker is woken, or a function that
returns one of these."""

_log = logging.getLogger("rosout.dyknow")


class Clock:
    """Steady time, in seconds."""

    def now(self) -> float:
        return time.monotonic()

    def wait(self, condition: threading.Condition, seconds: float | None) -> None:
        """Wait for a condition, whose lock is held, to be notified; at most ``seconds``."""
        condition.wait(seconds)


STEADY = Clock()
#: So that two threads that disable the collector do not enable it for each other.
_frames_lock = state_lock("frames of threads")


def attempt(what: str, work: Callable[[], T], logger: logging.Logger = _log) -> T | None:
    """Call ``work`` at the top of a thread; None if it raised, which is logged."""
    try:
        return work()
    except DyKnowError as error:
        logger.warning("%s: %s", what, error)
    except Exception:  # the boundary of the thread
        logger.exception("%s failed", what)
    return None


def current_frames() -> dict[int, FrameType]:
    """Return the frame at which each thread is, by the thread's identifier.

    A collection of garbage within ``sys._current_frames`` can stop the process for ever, before
    CPython 3.11.5 (gh-106883), so there is none.
    """
    with _frames_lock:
        was_enabled = gc.isenabled()
        gc.disable()
        try:
            return sys._current_frames()  # noqa: TID251
        finally:
            if was_enabled:
                gc.enable()


def in_background(
    what: str, work: Callable[[], object], logger: logging.Logger = _log
) -> threading.Thread:
    """Call ``work`` in a daemon thread of its own, which is returned; ``what`` names it."""
    thread = threading.Thread(target=attempt, args=(what, work, logger), name=what, daemon=True)
    thread.start()
    return thread


@dataclass
class _Key:
    """One key of a loop, with the numbers of rounds: the last that began, ended, is wanted."""

    name: str
    work: Callable[[], object]
    is_standing: bool
    pause: float
    #: When the next round may begin if the key is woken, and when it begins in any case.
    earliest: float
    due: float
    begun: int = 0
    ended: int = 0
    wanted: int = 0

    @property
    def is_running(self) -> bool:
        return self.begun > self.ended

    @property
    def next(self) -> float:
        """When its next round begins."""
        return self.earliest if self.wanted > self.begun else max(self.due, self.earliest)


class ControlLoop:
    """Rounds of work by key, on a few threads; a key never has two rounds at once.

    It is level-triggered: a wake says that a key may have something to do, and the round looks for
    itself; many wakes make one round. A round that fails is logged, and repeated after ``RETRY``
    seconds. Every method is safe from any thread; a round may close its own loop.

    Each standing key has a thread, so a slow round delays no other key; keys of ``once`` share
    those of the ``workers``. Without ``start`` the rounds run in the thread that calls
    ``advance``, in the order of time: simulations and tests are deterministic.
    """

    def __init__(
        self,
        workers: int = 0,
        clock: Clock = STEADY,
        logger: logging.Logger = _log,
        name: str = "control loop",
    ) -> None:
        """Make a loop without keys, and without threads before ``start``."""
        self._workers = workers
        self._clock = clock
        self._logger = logger
        self._name = name
        lock = reentrant_state_lock("control loop")
        #: One idle thread watches the keys; the others wait to take its place, so that what
        #: happens wakes one thread.
        self._changed = state_condition("control loop", lock)
        self._place_is_free = state_condition("control loop", lock)
        self._is_watched = False
        self._ended = state_condition("control loop", lock)
        self._keys: dict[str, _Key] = {}
        self._threads: list[threading.Thread] = []
        self._started = self._closed = False

    def add(self, key: str, work: Work, after: float | None = None, pause: float = PAUSE) -> None:
        """Add a standing key; ``work`` returns the seconds until the next round, None for a wake.

        The first round comes in ``after`` seconds, or with the first wake; ``pause`` is the least
        time until a round.
        """
        self._put(_Key(key, work, True, pause, *self._times(after, pause)))

    def once(self, key: str, work: Callable[[], object]) -> None:
        """Call ``work`` soon, once, unless the key waits or runs already; does not wait."""
        self._put(_Key(key, work, False, 0.0, *self._times(0.0)))

    def wake(self, key: str) -> int:
        """Ask for a round that begins from now on, and return its number; does not wait.

        A key that was not added has no rounds.
        """
        found = self._keys.get(key)
        if found is None:
            return 0
        if found.wanted <= found.begun:  # else its next round is requested already
            with self._changed:
                found.wanted = found.begun + 1
                self._changed.notify()
        return found.wanted

    def wait_for(self, key: str, number: int, timeout: float) -> bool:
        """Wait at most ``timeout`` s for the end of a round; returns whether it has ended.

        After ``close`` the round that is running ends, and no other begins.
        """
        with self._ended:
            found = self._keys[key]
            self._ended.wait_for(
                lambda: found.ended >= number or (self._closed and found.begun < number), timeout
            )
            return found.ended >= number

    @property
    def started(self) -> bool:
        """Whether `start` was called."""
        return self._started

    @property
    def running(self) -> bool:
        return any(thread.is_alive() for thread in self._threads)

    def requeue(self, key: str, after: float | None) -> None:
        """Let the next round of a standing key come in so many seconds; None for a wake."""
        with self._changed:
            _, self._keys[key].due = self._times(after)
            self._changed.notify()

    def start(self) -> None:
        """Start the threads, unless they were started or the loop is closed."""
        with self._changed:
            if not self._started and not self._closed:
                self._start_threads()
                self._started = True

    def advance(self, until: float) -> Iterator[float]:
        """Run the rounds that are due by then in this thread; yields the time before each."""
        while True:
            with self._changed:
                key = None if self._closed else self._first()
                if key is None or key.next > until:
                    return
                when = key.next
                key.begun += 1
            yield when
            self._round(key)

    def close(self, timeout: float = 0.0) -> None:
        """Start no further round; wait at most ``timeout`` s for those that run."""
        with self._changed:
            self._closed = True
            threads = self._threads
            for each in (self._changed, self._place_is_free, self._ended):
                each.notify_all()
        deadline = time.monotonic() + timeout
        for thread in threads:
            if thread is not threading.current_thread():
                thread.join(max(0.0, deadline - time.monotonic()))

    def _times(self, after: float | None, pause: float = 0.0) -> tuple[float, float]:
        now = self._clock.now()
        return now + pause, math.inf if after is None else now + after

    def _put(self, key: _Key) -> None:
        with self._changed:
            if key.name not in self._keys:
                self._keys[key.name] = key
                self._changed.notify()
                if self._started:
                    try:
                        self._start_threads()
                    except NO_THREAD:  # the next key tries again
                        if not self._threads:
                            raise

    def _start_threads(self) -> None:
        """Start the threads that are missing, also those that were refused before."""
        standing = sum(each.is_standing for each in self._keys.values())
        while len(self._threads) < self._workers + standing:
            self._threads.append(in_background(self._name, self._run, self._logger))

    def _run(self) -> None:
        key = self._take()
        while key is not None:
            self._round(key)
            key = self._take()

    def _take(self) -> _Key | None:
        """Wait until a round is due, and begin it; None once the loop is closed."""
        with self._changed:
            while not self._closed:
                key = self._first()
                left = math.inf if key is None else key.next - self._clock.now()
                if key is not None and left <= 0.0:
                    key.begun += 1
                    if not self._is_watched:
                        self._place_is_free.notify()
                    return key
                if self._is_watched:
                    self._clock.wait(self._place_is_free, None)
                else:
                    self._is_watched = True
                    self._clock.wait(self._changed, None if left == math.inf else left)
                    self._is_watched = False
        return None

    def _first(self) -> _Key | None:
        """Return the key whose round comes next, of those that may begin one now."""
        running = sum(each.is_running and not each.is_standing for each in self._keys.values())
        has_worker = running < self._workers or not self._started
        waiting = (
            each
            for each in self._keys.values()
            if not each.is_running and (each.is_standing or has_worker)
        )
        return min(waiting, key=attrgetter("next"), default=None)

    def _round(self, key: _Key) -> None:
        outcome: list[object] = []
        attempt(key.name, lambda: outcome.append(key.work()), self._logger)
        after, pause = (outcome[0], key.pause) if outcome else (RETRY, RETRY)
        with self._changed:
            key.ended = key.begun
            if key.is_standing:
                key.earliest, key.due = self._times(cast("Optional[float]", after), pause)
            else:
                del self._keys[key.name]
            self._changed.notify()
            self._ended.notify_all()


class PeriodicWorker:
    """A control loop of one key, on a thread of its own."""

    def __init__(
        self,
        what: str,
        work: Callable[[], object],
        period: Period = None,
        pause: float = PAUSE,
        logger: logging.Logger = _log,
        clock: Clock = STEADY,
    ) -> None:
        """``period``: seconds to the next round, or returns them; ``pause``: at least."""

        def round_() -> float | None:
            work()
            return self._until_next()

        self._what = what
        self._period = period
        self._loop = ControlLoop(0, clock, logger, what)
        self._loop.add(what, round_, pause=pause)
        self.close = self._loop.close

    @property
    def running(self) -> bool:
        return self._loop.running

    def start(self) -> None:
        """Start the thread, once; the first round comes after a period, or a wake."""
        if not self._loop.started:
            self._loop.requeue(self._what, self._until_next())  # before its thread waits for it
            self._loop.start()

    def _until_next(self) -> float | None:
        return self._period() if callable(self._period) else self._period

    def wake(self) -> int:
        """Ask for a round that begins from now on, and return its number."""
        return self._loop.wake(self._what)

    def wait_for(self, number: int, timeout: float) -> bool:
        """Wait at most ``timeout`` s for the end of a round; returns whether it has ended."""
        return self._loop.wait_for(self._what, number, timeout)


class Workers:
    """A few daemon threads on one queue, first in, first out."""

    def __init__(self, what: str, count: int) -> None:
        """Start ``count`` threads, with the name of their work for the log."""
        self._what = what
        self._numbers = itertools.count()
        self._loop = ControlLoop(count, name=what)
        self._loop.start()
        self.close = self._loop.close

    def run(self, work: Callable[[], object]) -> None:
        self._loop.once(f"{self._what} {next(self._numbers)}", work)


class EventQueue(Generic[Event]):
    """Passes events to a listener, one at a time and in order, outside the locks of the sender."""

    def __init__(self, listener: Callable[[Event], object]) -> None:
        self.listener = listener
        self._state_lock = state_lock("event queue")
        self._events: deque[Event] = deque()
        self._delivering = False

    def add(self, event: Event) -> None:
        """Append an event; called under the lock that decides the order."""
        with self._state_lock:
            self._events.append(event)

    def deliver(self) -> None:
        """Pass all events to the listener, unless another thread does; called under no lock.

        An error of the listener is logged.
        """
        while True:
            with self._state_lock:
                if self._delivering or not self._events:
                    return
                event = self._events.popleft()
                self._delivering = True
            try:
                attempt("a listener of events", partial(self.listener, event))
            finally:
                with self._state_lock:
                    self._delivering = False


class RunningClock:
    """Seconds for which this process has run; safe from any thread.

    A process that was stopped has received no messages meanwhile, so the silence of its peers
    means nothing. By this clock they still have their time to answer when the process goes on.
    """

    def __init__(self, steady: Callable[[], float] = time.monotonic) -> None:
        """Start at 0; it stands still between readings that are far apart."""
        self._steady = steady
        self._state_lock = state_lock("running clock")
        self._last = steady()
        self._run = 0.0

    def __call__(self) -> float:
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
