"""Who runs a callback, and when.

A *strand* runs its tasks one after another in the order in which they came; a nodelet has one,
so its callbacks never overlap. A *worker pool* runs many strands on few threads: a strand that
has something to do stands once in the pool's queue, and a flag says that it does ("busy": it
stands in the queue or runs). Who raises the flag puts the strand into the queue, who finds the
strand empty lowers it, both under the lock, so no wake-up is ever lost and nothing polls.

A callback that blocks holds its worker. When all workers are held and work waits, the watchdog
replaces one after another, so nodelets that block (or never return) do not starve the rest. It
wakes up only while there is work.
"""

from __future__ import annotations

import collections
import logging
import queue
import sys
import threading
import time
import traceback
import weakref
from typing import Callable, Deque, Dict, List, Optional, Tuple

from dyknow.nodelet.locking import message_lock

Task = Callable[[], object]
Clock = Callable[[], float]

#: Tasks that a strand runs before it lets others on its worker.
_BUDGET = 32
#: Seconds between two looks of the watchdog while there is work.
_LOOK = 0.2

_log = logging.getLogger("rosout.dyknow")


class Runner:
    """Whoever runs strands, with a count of the tasks that it has begun."""

    def __init__(self) -> None:
        self.turns = 0


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
        "name",
        "running",
    )

    def __init__(self, executor: Executor, name: str, held: bool = False) -> None:
        """Create a strand on ``executor``; a ``held`` one collects tasks until ``resume``."""
        self.name = name
        self.alive = True
        self.running = False
        self._tasks: Deque[Task] = collections.deque()
        self._busy = held
        self._ready = executor.ready
        self._held = held
        self._noted = False
        executor.strands.add(self)

    @property
    def busy(self) -> bool:
        """Whether a task is queued or runs, or the strand is held."""
        return self._busy

    def post(self, task: Task) -> None:
        """Run ``task`` after everything that was posted before; nothing if the strand is dead."""
        with message_lock:
            self.post_locked(task)

    def post_locked(self, task: Task) -> None:
        """Do the same for who has the lock."""
        if self.alive:
            self._tasks.append(task)
            was_busy, self._busy = self._busy, True
            if not was_busy:
                self._ready(self)

    def resume(self) -> None:
        """Start a strand that was created held; nothing if it runs already."""
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
        self.alive = False

    def run(self, runner: Runner) -> bool:
        """Run what is queued, called by one runner at a time; True if it must be queued again."""
        for _ in range(_BUDGET):
            with message_lock:
                if not self.alive:
                    self._tasks.clear()
                if not self._tasks:
                    self._busy = False
                    return False
                task = self._tasks.popleft()
            runner.turns += 1
            self.running = True
            try:
                task()
            except BaseException:  # the boundary: sys.exit() in a task must not end a worker
                _log.error("%s: a task failed\n%s", self.name, traceback.format_exc())
            self.running = False
            if self._noted:
                self._noted = False
                _log.info("%s: the callback that ran at the unload has ended", self.name)
        return True


class Executor:
    """What a strand needs to be run; keeps account of the strands for ``drain``."""

    def __init__(self) -> None:
        self.strands: weakref.WeakSet[Strand] = weakref.WeakSet()

    def ready(self, strand: Strand) -> None:
        """Take a strand that has something to do."""
        raise NotImplementedError

    def drain(self, timeout: float = 10.0) -> bool:
        """Return True once no strand has anything to do, False after ``timeout`` seconds."""
        raise NotImplementedError

    def close(self) -> None:
        """Stop; tasks that run are not waited for."""


class ManualExecutor(Executor):
    """Runs strands in the thread that calls ``drain`` or ``step``: for tests, deterministic."""

    def __init__(self) -> None:
        super().__init__()
        self._queue: Deque[Strand] = collections.deque()
        self._runner = Runner()

    def ready(self, strand: Strand) -> None:
        """Queue the strand until the next ``step``."""
        self._queue.append(strand)

    def step(self) -> bool:
        """Run the strand that has waited longest; False if none waits."""
        if not self._queue:
            return False
        strand = self._queue.popleft()
        if strand.run(self._runner):
            self._queue.append(strand)
        return True

    def drain(self, timeout: float = 10.0) -> bool:
        """Run until nothing is left to do."""
        while self.step():
            pass
        return True


class _Worker(Runner):
    """One thread of the pool, as the watchdog sees it."""

    def __init__(self) -> None:
        super().__init__()
        self.strand: Optional[Strand] = None
        self.replaced = False
        self.thread: Optional[threading.Thread] = None


class WorkerPool(Executor):
    """``size`` threads on one queue of strands.

    Args:
        size: callbacks that can run at the same time.
        stuck_after: seconds after which a callback that has not returned is reported, once.
    """

    def __init__(
        self, size: int, stuck_after: float = 10.0, clock: Clock = time.monotonic
    ) -> None:
        super().__init__()
        if size < 1:
            raise ValueError(f"a worker pool needs at least one worker, not {size}")
        self.size = size
        self._stuck_after = stuck_after
        self._clock = clock
        self._queue: queue.SimpleQueue[Optional[Strand]] = queue.SimpleQueue()
        self.ready = self._queue.put  # type: ignore[assignment, method-assign]  # one call less
        self._workers: List[_Worker] = []
        self._quiet = threading.Condition()
        self._drainers = 0
        self._closed = False
        self._awake = threading.Event()
        self._watchdog = threading.Thread(target=self._watch, name="dyknow-watchdog", daemon=True)
        for _ in range(size):
            self._hire()
        self._watchdog.start()

    @property
    def threads(self) -> int:
        """Workers at present; more than ``size`` while callbacks block."""
        return len(self._workers)

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
        self._closed = True
        self._awake.set()
        for _ in list(self._workers):
            self._queue.put(None)

    def _hire(self) -> None:
        worker = _Worker()
        worker.thread = threading.Thread(
            target=self._work, args=(worker,), name="dyknow-worker", daemon=True
        )
        self._workers.append(worker)
        worker.thread.start()

    def _work(self, worker: _Worker) -> None:
        get = self._queue.get
        while not worker.replaced and not self._closed:
            strand = get()
            if strand is None:
                break
            worker.strand = strand
            if not self._awake.is_set():
                self._awake.set()
            if strand.run(worker):
                self._queue.put(strand)
            worker.strand = None
            if self._drainers:
                with self._quiet:
                    self._quiet.notify_all()
        self._workers.remove(worker)

    def _watch(self) -> None:
        seen: Dict[_Worker, Tuple[int, float]] = {}
        reported: weakref.WeakKeyDictionary[_Worker, int] = weakref.WeakKeyDictionary()
        pause = threading.Event()
        while self._awake.wait() and not self._closed:
            pause.wait(_LOOK)
            now = self._clock()
            running = [(w, w.strand) for w in list(self._workers) if w.strand is not None]
            if not running and self._queue.empty():
                seen.clear()
                self._awake.clear()
                if any(w.strand is not None for w in list(self._workers)):
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
            if stuck and free <= 0 and not self._queue.empty():
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
