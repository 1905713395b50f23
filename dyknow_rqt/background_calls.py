# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Calls that may block, made in a pool; their results arrive in the thread of the window."""

from __future__ import annotations

import logging
import threading
from collections import deque
from typing import Callable, Deque, TypeVar

from python_qt_binding.QtCore import QObject, QTimer, Signal

from dyknow.workers import Workers

_LOG = logging.getLogger("rosout.dyknow_rqt")
T = TypeVar("T")


class BackgroundCalls(QObject):
    """A pool of daemon threads, so that a call that hangs does not hold up the end."""

    _delivered = Signal()

    def __init__(self, count: int = 4) -> None:
        """Start the threads; to be made in the thread of the window.

        Args:
            count: how many calls are made at the same time.
        """
        super().__init__()
        self._closed = threading.Event()
        self._results: Deque[Callable[[], None]] = deque()
        self._turns = QTimer(self)
        self._turns.setInterval(0)
        self._turns.timeout.connect(self._deliver)
        self._delivered.connect(self._turns.start)
        self._workers = Workers("dyknow_rqt worker", count)

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
        """Take in one result: what hands do meanwhile comes between it and the next."""
        if self._closed.is_set() or not self._results:
            self._turns.stop()
            return
        try:
            self._results.popleft()()
        except Exception:
            _LOG.exception("the result of a call could not be taken in")
