# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The time that timers follow: steady, or /clock when the system runs on simulated time."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Any, Optional

import rospy
import rospy.rostime
import rospy.timer

from dyknow.locks import flag_lock
from dyknow.nodelet.middleware import Ticker


class RospyTicker(Ticker):
    """What all tickers of ROS share: rospy's events."""

    def event(self, last: Any, expected: float, real: float, duration: Any) -> Any:
        """Make a ``rospy.timer.TimerEvent``, on the scale of ROS time."""
        now = rospy.Time.now()
        late = rospy.Duration.from_sec(max(0.0, real - expected))
        due = now - late if now.to_sec() > late.to_sec() else rospy.Time()
        return rospy.timer.TimerEvent(
            last.current_expected if last is not None else None,
            last.current_real if last is not None else None,
            due,
            now,
            duration,
        )


class SteadyTicker(RospyTicker):
    """Steady time; sleeps until the next timer is due."""

    def __init__(self) -> None:
        self._wake = flag_lock()  # free once it was woken
        self._wake.acquire()

    def now(self) -> float:
        """Steady seconds."""
        return time.monotonic()

    def wait(self, until: Optional[float]) -> None:
        """Sleep until then, or until woken."""
        if until is None:
            self._wake.acquire()
        else:
            timeout = max(0.0, until - time.monotonic())
            self._wake.acquire(timeout=min(timeout, threading.TIMEOUT_MAX))

    def wake(self) -> None:
        """End the sleep."""
        with contextlib.suppress(RuntimeError):  # it was woken already
            self._wake.release()


class ClockTicker(RospyTicker):
    """Simulated time; looks again with every message on /clock."""

    def __init__(self) -> None:
        self._changed: threading.Condition = rospy.rostime.get_rostime_cond()
        self._woken = False

    def now(self) -> float:
        """Seconds of /clock, 0 before its first message."""
        return float(rospy.rostime.get_time())

    def wait(self, until: Optional[float]) -> None:
        """Sleep until the clock says so, or until woken."""
        with self._changed:
            if not self._woken and (until is None or self.now() < until):
                self._changed.wait()
            self._woken = False

    def wake(self) -> None:
        """End the sleep."""
        with self._changed:
            self._woken = True
            self._changed.notify_all()


def make_ticker() -> Ticker:
    """Choose the time of the system; the node must be initialised."""
    return SteadyTicker() if rospy.rostime.is_wallclock() else ClockTicker()
