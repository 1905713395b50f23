# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Calls in worker threads, whose results arrive as signals, and slots that never raise."""

from __future__ import annotations

import functools
import inspect
import logging
import threading
from collections import deque
from typing import Any, Callable, Deque, TypeVar, cast

from python_qt_binding.QtCore import QObject, QTimer, Signal

from dyknow.errors import DyKnowError
from dyknow.periodic import Workers
from dyknow_rqt.graph.filters import BadFilter

_LOG = logging.getLogger("rosout.dyknow_rqt")
_Function = TypeVar("_Function", bound=Callable[..., Any])


def qt_slot(method: _Function) -> _Function:
    """Let a method be called by Qt.

    An exception is shown by the ``report`` of the object, if it has one: expected errors in their
    own words, others with their type, and logged with their traceback. Arguments of a signal that
    the method does not take are dropped.
    """
    most = len(inspect.signature(method).parameters) - 1

    @functools.wraps(method)
    def guard(self: Any, *args: Any) -> Any:
        try:
            return method(self, *args[:most])
        except (DyKnowError, BadFilter, OSError) as error:
            _report(self, str(error))
        except Exception as error:
            _LOG.exception("in %s", method.__qualname__)
            _report(self, f"{type(error).__name__} in {method.__qualname__}: {error}")
        return None

    return cast(_Function, guard)


def _report(owner: Any, text: str) -> None:
    report = getattr(owner, "report", None)
    if report is not None:
        report(text)


_LOG = logging.getLogger("rosout.dyknow_rqt")
T = TypeVar("T")


class BackgroundCalls(QObject):
    """A pool of daemon threads, so that a call that hangs does not hold up the end."""

    _delivered = Signal()

    def __init__(self, count: int = 4) -> None:
        """Start the threads for so many calls at a time; in the thread of the window."""
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
        """Take in one result: user input in the meantime comes between it and the next."""
        if self._closed.is_set() or not self._results:
            self._turns.stop()
            return
        try:
            self._results.popleft()()
        except Exception:
            _LOG.exception("the result of a call could not be taken in")
