# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Time that a test advances, from one timer to the next."""

from __future__ import annotations

from typing import Any, Optional

import rospy
import rospy.timer

from dyknow.locks import state_condition
from dyknow.nodelet.middleware import Ticker


class SteppedTicker(Ticker):
    """Time that stands still between two calls of ``set``.

    The thread of the timer queue waits here. ``next_due`` returns only once that thread has
    fired what is due and waits again, so a test never races with it.
    """

    def __init__(self) -> None:
        self._changed = state_condition("stepped ticker")
        self._seconds = 0.0
        self._used = False  # there was a timer, so the queue's thread runs
        self._waiting = False
        self._woken = False
        self._due: Optional[float] = None

    def now(self) -> float:
        """Seconds since the harness was made."""
        return self._seconds

    def set(self, seconds: float) -> None:
        """Set the time; timers that are due by then fire on the queue's thread."""
        with self._changed:
            if self._used and seconds < self._seconds:
                self._woken = True  # the queue has to see it
            self._seconds = seconds
            self._changed.notify_all()

    def next_due(self, timeout: float) -> Optional[float]:
        """Wait until everything due was fired; return when the next timer is due, None for never.

        Raises:
            TimeoutError: the queue's thread is still at work after ``timeout`` seconds.
        """
        with self._changed:
            if not self._changed.wait_for(self._is_settled, timeout):
                raise TimeoutError(f"the timers have not fired within {timeout:g} s")
            return self._due

    def wait(self, until: Optional[float]) -> None:
        """Block until the time is ``until`` (None: for ever), or until ``wake``."""
        with self._changed:
            self._waiting, self._due = True, until
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._woken or self._is_due())
            self._waiting = self._woken = False

    def wake(self) -> None:
        """End the present or the next ``wait``: timers came or went."""
        with self._changed:
            self._used = self._woken = True
            self._changed.notify_all()

    def event(self, last: Any, expected: float, real: float, duration: Any) -> Any:
        """Make a ``rospy.timer.TimerEvent``."""
        return rospy.timer.TimerEvent(
            last.current_expected if last is not None else None,
            last.current_real if last is not None else None,
            rospy.Time.from_sec(expected),
            rospy.Time.from_sec(real),
            duration,
        )

    def _is_due(self) -> bool:
        return self._due is not None and self._seconds >= self._due

    def _is_settled(self) -> bool:
        return not self._used or (self._waiting and not self._woken and not self._is_due())
