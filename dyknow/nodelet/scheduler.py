# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which thread runs a callback, and when.

A *strand* runs its tasks one after another in the order in which they came; a nodelet has one,
so its callbacks never overlap. A *worker pool* runs many strands on few threads: a strand that
has something to do stands once in the pool's queue, and a flag says that it does ("busy": it
stands in the queue or runs). The thread that raises the flag puts the strand into the queue; the
thread that finds the strand empty lowers it. Both happen under the lock of messages, so no wake-up
is ever lost and nothing polls.

The worker that was busy last is woken first: what it touched is still in the caches of its core,
and since one thread at a time runs Python, another core would gain nothing. A worker that was
woken and finds that another one did its work goes to the end of the line.

A callback that blocks holds its worker. When all workers are held and work waits, the watchdog
replaces one after another, so nodelets that block (or never return) do not starve the rest. It
wakes up only while there is work.
"""

from __future__ import annotations

import collections
import logging
import sys
import threading
import time
import traceback
import weakref
from typing import Callable, Deque, Dict, List, Optional, Tuple

from dyknow.locks import flag_lock, state_condition
from dyknow.nodelet.crash_record import CrashRecord
from dyknow.nodelet.locking import message_lock

Task = Callable[[], object]
Clock = Callable[[], float]

#: Seconds between two looks of the watchdog while there is work.
_LOOK = 0.2

_attempt, _wait, _leave = message_lock.attempt, message_lock.wait, message_lock.leave

_log = logging.getLogger("rosout.dyknow")


class Strand:
    """Serial executor: at most one of its tasks runs at any time, in the order of ``post``."""

    __slots__ = (
        "__weakref__",
        "_busy",
        "_held",
        "_noted",
        "_ready",
        "_tasks",
        "alive",
        "began",
        "clock",
        "mark",
        "name",
    )

    def __init__(self, executor: Executor, name: str, held: bool = False, mark: int = 0) -> None:
        """Create a strand on ``executor``; a ``held`` one collects tasks until ``resume``.

        Args:
            executor: what runs it.
            name: for the log.
            held: whether it waits for ``resume``.
            mark: of the nodelet whose code it runs, for the crash record.
        """
        self.name = name
        self.mark = mark
        self.alive = True
        #: When the task that runs now began, by ``clock``; 0.0 if none runs.
        self.began = 0.0
        self.clock = executor.clock
        self._tasks: Deque[Task] = collections.deque()
        self._busy = held
        self._ready = executor.ready
        self._held = held
        self._noted = False
        executor.strands.add(self)

    @property
    def running(self) -> bool:
        """Whether a task runs."""
        return self.began > 0.0

    @property
    def busy(self) -> bool:
        """Whether a task is queued or runs, or the strand is held."""
        return self._busy

    def post(self, task: Task) -> None:
        """Run ``task`` after everything that was posted before; nothing if the strand is dead."""
        with message_lock:
            self.post_locked(task)

    def post_locked(self, task: Task) -> None:
        """Same, with the lock held."""
        if self.alive:
            self._tasks.append(task)
            was_busy, self._busy = self._busy, True
            if not was_busy:
                self._ready(self)

    def resume(self) -> None:
        """Start a strand that was created held; nothing if it runs already."""
        with message_lock:
            if self._held:
                self._held = False
                self._ready(self)

    def kill(self, noted: bool = False) -> None:
        """Drop what is queued and refuse what comes; a task that runs is not waited for.

        Args:
            noted: say in the log when the task that runs now has ended.
        """
        if noted and self.running:
            self._noted = True
        with message_lock:
            self.alive = False
            dropped, self._tasks = self._tasks, collections.deque()
        del dropped  # without the lock: whatever goes with the tasks may call anything

    # For executors, which hold the lock in ``take`` and ``try_idle``:

    def take(self) -> Optional[Task]:
        """Return the oldest task, to run it; None if there is none."""
        return self._tasks.popleft() if self._tasks and self.alive else None

    def run(self, task: Task) -> None:
        """Run a task; called by one thread at a time."""
        self.began = self.clock()
        try:
            task()
        except BaseException:  # the boundary: sys.exit() in a task must not end a worker
            _log.error("%s: a task failed\n%s", self.name, traceback.format_exc())
        self.began = 0.0
        if self._noted:
            self._noted = False
            _log.info("%s: the callback that ran at the unload has ended", self.name)

    def try_idle(self) -> bool:
        """Be idle from now on; False if there is more to do."""
        if self._tasks:
            if self.alive:
                return False
            self._tasks.clear()
        self._busy = False
        return True


class Executor:
    """Runs strands, and knows them all for ``drain``."""

    def __init__(
        self, record: Optional[CrashRecord] = None, clock: Clock = time.monotonic
    ) -> None:
        self.clock = clock
        self.strands: weakref.WeakSet[Strand] = weakref.WeakSet()
        #: Where threads note whose code they run.
        self.record = record or CrashRecord()

    def ready(self, strand: Strand) -> None:
        """Take a strand that has something to do; the caller has the lock."""
        raise NotImplementedError

    def drain(self, timeout: float = 10.0) -> bool:
        """Return True once no strand has anything to do, False after ``timeout`` seconds."""
        raise NotImplementedError

    def close(self) -> None:
        """Stop; tasks that run are not waited for."""


class ManualExecutor(Executor):
    """Runs tasks in the thread that calls ``drain`` or ``step``: for tests, deterministic."""

    def __init__(self) -> None:
        super().__init__()
        self._queue: Deque[Strand] = collections.deque()

    def ready(self, strand: Strand) -> None:
        """Queue the strand until the next ``step``."""
        self._queue.append(strand)

    def step(self) -> bool:
        """Run a task of the strand that has waited longest; False if none waits."""
        if not self._queue:
            return False
        strand = self._queue.popleft()
        with message_lock:
            task = strand.take()
        if task is not None:
            strand.run(task)
        with message_lock:
            if not strand.try_idle():
                self.ready(strand)
        return True

    def drain(self, timeout: float = 10.0) -> bool:
        """Run until nothing is left to do."""
        while self.step():
            pass
        return True


class _Worker:
    """One thread of the pool.

    Attributes:
        strand: what it works on; None while it waits.
        turns: tasks that it has begun.
        replaced: whether it is to end as soon as it can, since another was hired in its place.
        wake: taken while it sleeps, released to wake it.
        word: its index in the crash record.
    """

    def __init__(self, word: int) -> None:
        self.word = word
        self.strand: Optional[Strand] = None
        self.turns = 0
        self.replaced = False
        self.thread: Optional[threading.Thread] = None
        self.wake = flag_lock()
        self.wake.acquire()


class WorkerPool(Executor):
    """``size`` threads on one queue of strands, a task at a time.

    Args:
        size: callbacks that can run at the same time.
        stuck_after: seconds after which a callback that has not returned is reported, once.
        clock: seconds, steady.
        record: where its threads note whose code they run.
    """

    def __init__(
        self,
        size: int,
        stuck_after: float = 10.0,
        clock: Clock = time.monotonic,
        record: Optional[CrashRecord] = None,
    ) -> None:
        super().__init__(record, clock)
        if size < 1:
            raise ValueError(f"a worker pool needs at least one worker, not {size}")
        self.size = size
        self._stuck_after = stuck_after
        self._clock = clock
        self._queue: Deque[Strand] = collections.deque()
        self._idle: Deque[_Worker] = collections.deque()
        self._woken = 0  # workers that were woken and have not noticed yet
        self._workers: List[_Worker] = []
        self._quiet = state_condition("worker pool")
        self._drainers = 0
        self._closed = False
        self._awake = threading.Event()
        self._dozes = True  # the watchdog, as nothing is done
        self._watchdog = threading.Thread(target=self._watch, name="dyknow-watchdog", daemon=True)
        for _ in range(size):
            self._hire()
        self._watchdog.start()

    @property
    def threads(self) -> int:
        """Workers at present; more than ``size`` while callbacks block."""
        return len(self._workers)

    def ready(self, strand: Strand) -> None:
        """Queue the strand, and wake a worker unless enough of them are on their way."""
        self._queue.append(strand)
        if len(self._queue) > self._woken:
            self._wake_one()

    def _wake_one(self) -> None:
        if self._idle:
            self._woken += 1
            self._idle.pop().wake.release()

    def drain(self, timeout: float = 10.0) -> bool:
        """Wait until no strand has anything to do."""
        with self._quiet:
            self._drainers += 1
            try:
                return self._quiet.wait_for(
                    lambda: not any(s.busy for s in list(self.strands) if s.alive), timeout
                )
            finally:
                self._drainers -= 1

    def close(self) -> None:
        """End the workers that are free; those that run a callback end with it."""
        with message_lock:
            self._closed = True
            while self._idle:
                self._wake_one()
        self._awake.set()

    def _hire(self) -> None:
        worker = _Worker(self.record.take())
        worker.thread = threading.Thread(
            target=self._work, args=(worker,), name="dyknow-worker", daemon=True
        )
        self._workers.append(worker)
        worker.thread.start()

    def _work(self, worker: _Worker) -> None:
        strand: Optional[Strand] = None
        line_up = self._idle.append
        words, word = self.record.words, worker.word
        while True:
            if not _attempt(False):
                _wait()
            try:
                if strand is not None and not strand.try_idle():
                    self._queue.append(strand)
                strand = task = None
                if self._closed or worker.replaced:
                    if self._queue:
                        self._wake_one()  # in place of this one
                    break
                if self._queue:
                    strand = self._queue.popleft()
                    task = strand.take()
                    worker.turns += 1
                else:
                    line_up(worker)
                worker.strand = strand
            finally:
                _leave()
            if task is not None and strand is not None:
                if self._dozes:
                    self._dozes = False
                    self._awake.set()
                words[word] = strand.mark
                strand.run(task)
                line_up = self._idle.append
            elif strand is None:
                words[word] = 0
                if self._drainers:
                    with self._quiet:
                        self._quiet.notify_all()
                worker.wake.acquire()
                with message_lock:
                    self._woken -= 1
                line_up = self._idle.appendleft  # unless it finds something to do now
        worker.strand = None
        self.record.give_back(word)
        self._workers.remove(worker)

    def _watch(self) -> None:
        seen: Dict[_Worker, Tuple[int, float]] = {}
        reported: weakref.WeakKeyDictionary[_Worker, int] = weakref.WeakKeyDictionary()
        pause = threading.Event()
        while self._awake.wait() and not self._closed:
            pause.wait(_LOOK)
            now = self._clock()
            running = [(w, w.strand) for w in list(self._workers) if w.strand is not None]
            if not running and not self._queue:
                seen.clear()
                self._awake.clear()
                self._dozes = True
                if any(w.strand is not None for w in list(self._workers)):
                    self._dozes = False
                    self._awake.set()  # taken up between the look and the clear
                continue
            before, seen = seen, {}
            stuck = []
            for worker, strand in running:
                last = before.get(worker)
                turn = worker.turns
                if last is None or last[0] != turn:
                    seen[worker] = (turn, now)
                    continue
                seen[worker] = last
                stuck.append(worker)
                if now - last[1] >= self._stuck_after and reported.get(worker) != turn:
                    reported[worker] = turn
                    self._report(worker, strand, now - last[1])
            free = len(self._workers) - len(stuck)
            if stuck and free <= 0 and self._queue:
                oldest = min(
                    (w for w in stuck if not w.replaced), key=lambda w: seen[w][1], default=None
                )
                if oldest is not None and oldest.turns == seen[oldest][0]:
                    oldest.replaced = True
                    self._hire()

    @staticmethod
    def _report(worker: _Worker, strand: Strand, seconds: float) -> None:
        thread = worker.thread
        frame = sys._current_frames().get(thread.ident or 0) if thread is not None else None
        where = "".join(traceback.format_stack(frame)) if frame is not None else ""
        _log.warning(
            "%s: a callback has not returned for %.0f s; its other callbacks wait\n%s",
            strand.name,
            seconds,
            where,
        )
