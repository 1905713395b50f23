# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Calls that may block, made in a pool; their results arrive in the thread of the window."""

from __future__ import annotations

import logging
import threading
from typing import Callable, TypeVar

from python_qt_binding.QtCore import QObject, Signal

from dyknow.workers import Workers

_LOG = logging.getLogger("rosout.dyknow_rqt")
T = TypeVar("T")


class BackgroundCalls(QObject):
    """A pool of daemon threads, so that a call that hangs does not hold up the end."""

    _delivered = Signal(object)

    def __init__(self, count: int = 4) -> None:
        """Start the threads; to be made in the thread of the window.

        Args:
            count: how many calls are made at the same time.
        """
        super().__init__()
        self._closed = threading.Event()
        self._delivered.connect(self._deliver)
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
        """Call a function in the thread of the window; from any thread."""
        if not self._closed.is_set():
            try:
                self._delivered.emit(function)
            except RuntimeError:
                self._closed.set()  # Qt has taken the window apart meanwhile

    def close(self) -> None:
        """Deliver nothing more; does not wait for calls that still run."""
        self._closed.set()
        self._workers.close()

    def _deliver(self, function: Callable[[], None]) -> None:
        if self._closed.is_set():
            return
        try:
            function()
        except Exception:
            _LOG.exception("the result of a call could not be taken in")
