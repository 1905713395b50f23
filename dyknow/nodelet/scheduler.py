# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which thread runs a callback, and when.

A *strand* runs its tasks one after another in the order in which they came; a nodelet has one,
so its callbacks never overlap. An *executor* runs many strands. A strand that has something to do
stands once in the executor's queue, and a flag says that it does ("busy": it stands in the queue
or runs). The thread that raises the flag puts the strand into the queue; the thread that finds the
strand empty lowers it. Both happen under the lock of messages, so no wake-up is lost and nothing
polls.
"""

from __future__ import annotations

import collections
import logging
import sys
import threading
import time
import traceback
import weakref
from typing import Callable

from dyknow.locks import flag_lock, reentrant_state_lock, state_condition
from dyknow.nodelet.crash_record import CrashRecord, as_word
from dyknow.periodic import NO_THREAD, current_frames

Task = Callable[[], object]
Clock = Callable[[], float]

_LOOK = 0.2  # period of the watchdog while there is work, in seconds
_STAY = 5.0  # seconds for which a thread without work stays in a pool that grows

_log = logging.getLogger("rosout.dyknow")


class MessageLock:
    """The lock that every message passes, of publications, queues and strands together.

    The work under it takes about a microsecond, and no code of a nodelet is called there. So it is
    contended only if its holder has to hand over the interpreter in the middle. A thread that
    finds it taken lets other threads run until it is free. Queueing up would be far slower (a
    sixth of the throughput was left): a thread in a queue is handed the lock while it has no
    interpreter, and then all stand in line at every message. The lock is reentrant, since a signal
    handler or a finalizer that publishes may come in between.

    The path of messages uses its parts, since ``with`` costs twice as much::

        if not attempt(False):
            wait()
        try:
            ...
        finally:
            leave()
    """

    def __init__(self) -> None:
        lock = reentrant_state_lock("messages")
        self.attempt = lock.acquire
        self.leave = lock.release

    def wait(self) -> None:
        """Let other threads run until the lock is free, and take it."""
        while not self.attempt(False):
            time.sleep(0)

    def __enter__(self) -> None:
        self.wait()

    def __exit__(self, *unused: object) -> None:
        self.leave()


message_lock = MessageLock()

_attempt, _wait, _leave = message_lock.attempt, message_lock.wait, message_lock.leave


class Strand:
    """Runs at most one of its tasks at any time, in the order of ``post``.

    One that is ``held`` only collects tasks until ``resume``.
    """

    __slots__ = tuple(
        """__weakref__ _busy _held _is_end_logged _ready _tasks
        alive began clock mark name""".split()
    )

    def __init__(self, executor: Executor, name: str, held: bool = False, mark: int = 0) -> None:
        self.name = name
        self.mark = as_word(mark)
        self.alive = True
        #: When the running task began, by ``clock``; None if none runs.
        self.began: float | None = None
        self.clock = executor.clock
        self._tasks: collections.deque[Task] = collections.deque()
        self._busy = held
        self._ready = executor.ready
        self._held = held
        self._is_end_logged = False
        executor.strands.add(self)

    @property
    def age(self) -> float:
        """Seconds for which the present task has been running; 0.0 if none runs."""
        began = self.began
        # Above 0 even where a test's clock stands still.
        return 0.0 if began is None else max(self.clock() - began, sys.float_info.min)

    @property
    def busy(self) -> bool:
        """Whether a task is queued or runs, or the strand is held."""
        return self._busy

    def post(self, task: Task) -> None:
        """Run ``task`` after everything that was posted before; nothing if the strand is dead."""
        with message_lock:
            self.post_locked(task)

    def post_locked(self, task: Task) -> None:
        if self.alive:
            self._tasks.append(task)
            if not self._busy:
                self._busy = True
                self._ready(self)

    def resume(self) -> None:
        with message_lock:
            if self._held:
                self._held = False
                self._ready(self)

    def kill(self, log_end: bool = False) -> None:
        """Drop the queued tasks and refuse further ones; log the end of one that runs."""
        if log_end and self.began is not None:
            self._is_end_logged = True
        with message_lock:
            self.alive = False
            if self._held:
                self._held = self._busy = False
            dropped, self._tasks = self._tasks, collections.deque()
        del dropped  # without the lock: finalizers of the tasks may call anything

    # For executors, one thread at a time:

    def run(self, task: Task) -> None:
        self.began = self.clock()
        try:
            task()
        except BaseException:  # the boundary: sys.exit() in a task must not end a worker
            self.log_failure()
        self.began = None
        if self._is_end_logged:
            self.log_end()

    def log_failure(self) -> None:
        _log.error("%s: a task failed\n%s", self.name, traceback.format_exc())

    def log_end(self) -> None:
        """Log, once, the end of the task that was running when the strand was killed."""
        self._is_end_logged = False
        _log.info("%s: the callback that ran at the unload has ended", self.name)


class Executor:
    """Runs strands, on threads that ``record`` whose code they run."""

    def __init__(self, record: CrashRecord | None = None, clock: Clock = time.monotonic) -> None:
        self.clock = clock
        self.strands: weakref.WeakSet[Strand] = weakref.WeakSet()
        self.record = record or CrashRecord()

    def ready(self, strand: Strand) -> None:
        """Queue a strand that has something to do; called with the lock held."""
        raise NotImplementedError

    def drain(self, timeout: float = 10.0) -> bool:
        """Return True once no strand has anything to do, False after ``timeout`` seconds."""
        raise NotImplementedError

    def catch_up(self) -> None:
        """Start tasks that wait for a thread which the system refused; to be called repeatedly."""

    def close(self) -> None:
        """Stop, without waiting for running tasks."""


class ManualExecutor(Executor):
    """Runs tasks in the thread that calls ``drain`` or ``step``: for tests, deterministic."""

    def __init__(self, clock: Clock = time.monotonic) -> None:
        super().__init__(clock=clock)
        self._queue: collections.deque[Strand] = collections.deque()

    def ready(self, strand: Strand) -> None:
        self._queue.append(strand)

    def step(self) -> bool:
        """Run a task of the strand that has waited longest; False if none waits."""
        if not self._queue:
            return False
        strand = self._queue.popleft()
        with message_lock:
            task = strand._tasks.popleft() if strand._tasks else None
        if task is not None:
            strand.run(task)
        with message_lock:
            if strand._tasks:
                self.ready(strand)
            else:
                strand._busy = False
        return True

    def drain(self, timeout: float = 10.0) -> bool:
        while self.step():
            pass
        return True


class _Worker:
    """One thread of a pool."""

    def __init__(self) -> None:
        self.strand: Strand | None = None  # the one that it runs; None while it waits
        #: Whether it is to end as soon as it can, since another was hired in its place.
        self.replaced = False
        self.wake = flag_lock()  # taken while it sleeps
        self.wake.acquire()
        self.thread: threading.Thread | None = None


class WorkerPool(Executor):
    """Threads on one queue of strands, a task at a time.

    The worker that was busy last is woken first: its data is still in the caches of its core, and
    since one thread at a time runs Python, another core would gain nothing. A worker that was
    woken and finds that another one did its work goes to the end of the line.

    A callback that blocks holds its worker. In a pool of fixed size a watchdog replaces one worker
    after another when all are held and work waits, so nodelets that block (or never return) do not
    starve the rest. A pool that grows has a thread for every strand with work at once, as rospy
    has; it is for callbacks that may block for long, as those of unchanged scripts do.

    Where the system refuses a thread, callbacks wait for a worker that is free, or for the next
    attempt: of the watchdog or, in a pool that grows, of ``catch_up``. The threads that post them
    are not told: they can do nothing about it, and hold the lock of messages.
    """

    def __init__(
        self,
        size: int | None,
        stuck_after: float = 10.0,
        clock: Clock = time.monotonic,
        record: CrashRecord | None = None,
        stay: float = _STAY,
    ) -> None:
        """Start the threads: one for each of ``size`` callbacks at the same time, or None to grow.

        A callback that has not returned ``stuck_after`` seconds is reported, once. In a pool that
        grows, threads without work ``stay`` so many seconds.
        """
        super().__init__(record, clock)
        if size is not None and size < 1:
            raise ValueError(f"a worker pool needs at least one worker, not {size}")
        self._grows = size is None
        self._stay = stay if self._grows else -1.0
        self._stuck_after = stuck_after
        self._queue: collections.deque[Strand] = collections.deque()
        self._idle: collections.deque[_Worker] = collections.deque()
        self._woken = 0  # workers that were woken and have not noticed yet
        self._workers: list[_Worker] = []
        self._quiet = state_condition("worker pool")
        self._drainers = 0
        self._closed = False
        self._awake = threading.Event()
        self._dozes = not self._grows  # the watchdog, as nothing is done
        self._refusal: Exception | None = None  # of the last thread
        self._is_refusal_logged = False
        try:
            for _ in range(size or 0):
                self._hire()
            if not self._grows:
                self._watchdog = threading.Thread(
                    target=self._watch, name="dyknow-watchdog", daemon=True
                )
                self._watchdog.start()
        except NO_THREAD:
            self.close()
            raise

    @property
    def threads(self) -> int:
        """Workers at present; more than the size of the pool while callbacks block."""
        return len(self._workers)

    def ready(self, strand: Strand) -> None:
        self._queue.append(strand)
        if len(self._queue) > self._woken:  # else enough workers are on their way
            self._wake_one()

    def drain(self, timeout: float = 10.0) -> bool:
        with self._quiet:
            self._drainers += 1
            try:
                return self._quiet.wait_for(
                    lambda: not any(s.busy for s in list(self.strands) if s.alive), timeout
                )
            finally:
                self._drainers -= 1

    def catch_up(self) -> None:
        if self._refusal is not None and self._grows:
            with message_lock:
                refusal, self._refusal = self._refusal, None
                while len(self._queue) > self._woken and self._wake_one():
                    pass
            self._log_refusal(refusal)

    def close(self) -> None:
        """End the free workers at once, and the busy ones with their callbacks."""
        with message_lock:
            self._closed = True
            while self._idle:
                self._wake_one()
        self._awake.set()

    def _wake_one(self) -> bool:
        """Have a worker look at the queue, with the lock held; False if there is none."""
        if self._idle:
            self._woken += 1
            self._idle.pop().wake.release()
        elif self._grows and not self._closed and self._has_hired():
            self._woken += 1  # the new one looks when the lock is free
        else:
            return False
        return True

    def _has_hired(self) -> bool:
        """Hire a worker; False if the system refuses its thread."""
        try:
            self._hire()
        except NO_THREAD as refusal:
            self._refusal = refusal.with_traceback(None)
            return False
        return True

    def _hire(self) -> None:
        worker = _Worker()
        worker.thread = threading.Thread(
            target=self._work, args=(worker,), name="dyknow-worker", daemon=True
        )
        self._workers.append(worker)
        try:
            worker.thread.start()
        except NO_THREAD:
            self._workers.remove(worker)
            raise

    def _log_refusal(self, refusal: Exception | None) -> None:
        """Log a refused thread, once until there are enough again; called without the lock."""
        if refusal is not None and not self._is_refusal_logged:
            _log.error(
                "no thread can be started for callbacks, which wait (%s): see ulimit -u, and "
                "pids.max of the control group",
                refusal,
            )
        self._is_refusal_logged = self._refusal is not None

    def _work(self, worker: _Worker) -> None:
        strand: Strand | None = None
        words, word = self.record.words, self.record.take()
        queue, clock = self._queue, self.clock
        is_woken = self._grows
        while True:
            if not _attempt(False):
                _wait()
            try:
                line_up = self._idle.append
                if is_woken:
                    is_woken = False
                    self._woken -= 1
                    line_up = self._idle.appendleft  # unless it finds something to do now
                if strand is not None:
                    if strand._tasks:  # as take and try_idle, without their calls
                        queue.append(strand)
                    else:
                        strand._busy = False
                strand = task = None
                if self._closed or worker.replaced:
                    if queue:
                        self._wake_one()  # in place of this one
                    break
                if queue:
                    strand = queue.popleft()
                    if strand._tasks:
                        task = strand._tasks.popleft()
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
                strand.began = clock()  # as run, without its call
                try:
                    task()
                except BaseException:  # the boundary
                    strand.log_failure()
                strand.began = None
                if strand._is_end_logged:
                    strand.log_end()
            elif strand is None:
                words[word] = 0.0
                self._notify_drainers()
                if not worker.wake.acquire(timeout=self._stay) and self._has_retired(worker):
                    break
                is_woken = True
        worker.strand = None
        self.record.give_back(word)
        self._workers.remove(worker)
        self._notify_drainers()

    def _notify_drainers(self) -> None:
        if self._drainers:
            with self._quiet:
                self._quiet.notify_all()

    def _has_retired(self, worker: _Worker) -> bool:
        """Take a worker without work out of the line; False if it was woken just now."""
        with message_lock:
            if worker in self._idle:
                self._idle.remove(worker)
                return True
        worker.wake.acquire()
        return False

    def _watch(self) -> None:
        reported: weakref.WeakKeyDictionary[_Worker, float] = weakref.WeakKeyDictionary()
        pause = threading.Event()
        while self._awake.wait() and not self._closed:
            pause.wait(_LOOK)
            working = [(w, w.strand) for w in list(self._workers) if w.strand is not None]
            if not working and not self._queue:
                self._awake.clear()
                self._dozes = True
                if any(w.strand is not None for w in list(self._workers)):
                    self._dozes = False
                    self._awake.set()  # taken up between the check and the clear
                continue
            now = self.clock()
            stuck: dict[_Worker, float] = {}
            for worker, strand in working:
                began = strand.began
                if began is not None and worker.strand is strand and now - began >= _LOOK:
                    stuck[worker] = began
                    if now - began >= self._stuck_after and reported.get(worker) != began:
                        reported[worker] = began
                        self._report(worker, strand, now - began)
            if stuck and len(stuck) >= len(self._workers) and self._queue:
                held = sorted((w for w in stuck if not w.replaced), key=stuck.__getitem__)
                for worker in held[:1]:
                    self._replace(worker, stuck[worker])

    def _replace(self, worker: _Worker, began: float) -> None:
        """Hire a worker in the place of one whose callback began then, and still runs."""
        with message_lock:  # so that it does not end meanwhile
            busy_with = worker.strand
            if busy_with is not None and busy_with.began == began:
                self._refusal = None
                worker.replaced = self._has_hired()
        self._log_refusal(self._refusal)

    @staticmethod
    def _report(worker: _Worker, strand: Strand, seconds: float) -> None:
        thread = worker.thread
        frame = current_frames().get(thread.ident or 0) if thread is not None else None
        _log.warning(
            "%s: a callback has not returned for %.0f s; its other callbacks wait\n%s",
            strand.name,
            seconds,
            "".join(traceback.format_stack(frame)) if frame is not None else "",
        )
