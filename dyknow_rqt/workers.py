"""Threads for calls that may block; what they come to is delivered in the thread of the window."""

from __future__ import annotations

import logging
import queue
import threading
from typing import Any, Callable, Optional, Tuple

from python_qt_binding.QtCore import QObject, Signal

_LOG = logging.getLogger("rosout.dyknow_rqt")
_Job = Tuple[Callable[[], Any], Callable[[Any], None], Callable[[Exception], None]]


class Workers(QObject):
    """A few threads on one queue. They are daemons: a call that hangs does not hold up the end."""

    _delivered = Signal(object)

    def __init__(self, count: int = 4) -> None:
        """Start the threads; to be made in the thread of the window."""
        super().__init__()
        self._jobs: queue.SimpleQueue[Optional[_Job]] = queue.SimpleQueue()
        self._count = count
        self._closed = threading.Event()
        self._delivered.connect(self._deliver)
        for number in range(count):
            name = f"dyknow_rqt worker {number}"
            threading.Thread(target=self._run, name=name, daemon=True).start()

    def run(
        self,
        job: Callable[[], Any],
        done: Callable[[Any], None],
        failed: Callable[[Exception], None],
    ) -> None:
        """Call ``job`` in a worker, then ``done`` or ``failed`` in the thread of the window."""
        self._jobs.put((job, done, failed))

    def deliver(self, function: Callable[[], None]) -> None:
        """Call a function in the thread of the window; from any thread."""
        if not self._closed.is_set():
            try:
                self._delivered.emit(function)
            except RuntimeError:
                self._closed.set()  # Qt has taken the window apart meanwhile

    def close(self) -> None:
        """Deliver nothing more; returns at once."""
        self._closed.set()
        for _ in range(self._count):
            self._jobs.put(None)

    def _run(self) -> None:
        while True:
            entry = self._jobs.get()
            if entry is None or self._closed.is_set():
                return
            job, done, failed = entry
            try:
                result = job()
            except Exception as error:
                self._hand_over(failed, error)
            else:
                self._hand_over(done, result)

    def _hand_over(self, receiver: Callable[[Any], None], value: Any) -> None:
        self.deliver(lambda: receiver(value))

    def _deliver(self, function: Callable[[], None]) -> None:
        if self._closed.is_set():
            return
        try:
            function()
        except Exception:
            _LOG.exception("the result of a worker could not be taken in")
