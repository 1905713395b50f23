# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Calls in worker threads, and long work of the interface's own, in slices."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from typing import Callable, Iterator, TypeVar

from python_qt_binding.QtCore import QObject, QTimer, Signal

from dyknow.errors import DyKnowError
from dyknow.periodic import Workers

_LOG = logging.getLogger("rosout.dyknow_rqt")
T = TypeVar("T")


class BackgroundCalls(QObject):
    """A pool of daemon threads, so that a call that hangs does not hold up the end."""

    _delivered = Signal()

    def __init__(self, count: int = 4) -> None:
        """Start the threads for so many calls at a time; in the thread of the window."""
        super().__init__()
        self._closed = threading.Event()
        self._results: deque[Callable[[], None]] = deque()
        self._turns = QTimer(self, interval=0, timeout=self._deliver)
        self._delivered.connect(self._turns.start)
        #: Calls that run one at a time, each with the call that follows it.
        self._once: dict[str, Callable[[], None] | None] = {}
        self._workers = Workers("dyknow_rqt worker", count)

    @property
    def is_calling(self) -> bool:
        """Whether a call that runs one at a time is under way."""
        return bool(self._once)

    def run(
        self, job: Callable[[], T], done: Callable[[T], None], failed: Callable[[Exception], None]
    ) -> None:
        """Call ``job`` in the pool, then ``done`` or ``failed`` in the thread of the window."""

        def work() -> None:
            try:
                result = job()
            except Exception as error:
                failure = error  # the name `error` is deleted at the end of this block
                self.deliver(lambda: failed(failure))
            else:
                self.deliver(lambda: done(result))

        self._workers.run(work)

    def run_once(
        self, what: str, job: Callable[[], T], done: Callable[[T], None], again: bool = False
    ) -> None:
        """Call ``job`` in the pool, then ``done``, unless a call of its name is under way.

        With ``again`` it is then called once more when that has ended. Errors that are not of
        DyKnow are logged.
        """
        if what in self._once:
            if again:
                self._once[what] = lambda: self.run_once(what, job, done)
            return
        self._once[what] = None

        def end() -> None:
            follow = self._once.pop(what)
            if follow is not None:
                follow()

        def take(answer: T) -> None:
            end()
            done(answer)

        def fail(error: Exception) -> None:
            if not isinstance(error, DyKnowError):
                _LOG.error("reading %s failed", what, exc_info=error)
            end()

        self.run(job, take, fail)

    def deliver(self, function: Callable[[], None]) -> None:
        """Call a function in the thread of the window, in a turn of its own; from any thread."""
        if not self._closed.is_set():
            self._results.append(function)
            try:
                self._delivered.emit()
            except RuntimeError:
                self._closed.set()  # Qt has taken the window apart meanwhile

    def close(self) -> None:
        """Deliver nothing more; does not wait for calls that still run."""
        self._closed.set()
        self._workers.close()

    def _deliver(self) -> None:
        """Take in one result: user input in the meantime comes between it and the next."""
        if self._closed.is_set() or not self._results:
            self._turns.stop()
            return
        self._results.popleft()()


#: A function that yields where its work may be interrupted.
Job = Callable[[], Iterator[None]]
#: Seconds of work until the next turn of the event loop.
SLICE = 0.02


class Slices(QObject):
    """Does jobs one after the other, each once however often it was wanted meanwhile.

    It is working while a slice is being done; between two of them a user may be at work.
    """

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self.is_working = False
        self._steps: dict[Job, Iterator[None]] = {}
        self._again: set[Job] = set()
        self._timer = QTimer(self, interval=0, timeout=self.go_on)

    def want(self, job: Job) -> None:
        """Do a job soon, and once more if it is under way."""
        if job in self._steps:
            self._again.add(job)
        else:
            self._steps[job] = job()
            self._timer.start()

    def is_wanted(self, job: Job) -> bool:
        return job in self._steps

    def close(self) -> None:
        self._timer.stop()
        self._steps.clear()

    def go_on(self) -> None:
        """Do one slice."""
        self.is_working = True
        try:
            self._do(time.monotonic() + SLICE)
        finally:
            self.is_working = False
        if not self._steps:
            self._timer.stop()

    def _do(self, end: float) -> None:
        for job in list(self._steps):
            try:
                for _ in self._steps[job]:
                    if time.monotonic() > end:
                        return
            except BaseException:
                self._steps.pop(job, None)
                raise
            self._steps.pop(job, None)
            if job in self._again:
                self._again.discard(job)
                self._steps[job] = job()
