# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Time that a test moves by hand, and waiting for other threads in real time."""

from __future__ import annotations

import threading
import time
from typing import Any, Callable, Dict, Optional, Tuple

import pytest

from dyknow.periodic import Clock
from dyknow.simulated import SimulatedClock

#: Seconds until a test gives up waiting for threads: far more than a busy machine needs.
PATIENCE = 60.0


def eventually(condition: Callable[[], object], period: float = 0.005) -> None:
    """Wait until a condition holds that other threads bring about; look each ``period`` s."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not become true"
        time.sleep(period)


def wait_for(event: threading.Event) -> None:
    assert event.wait(PATIENCE), "it did not happen"


def in_thread(call: Callable[[], object]) -> threading.Thread:
    """Run ``call`` on a thread of its own."""
    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    return thread


def join(*threads: threading.Thread) -> None:
    """Wait for threads that must end."""
    for thread in threads:
        thread.join(PATIENCE)
        assert not thread.is_alive(), "a thread has not ended"


def patch_here(
    patch: pytest.MonkeyPatch, owner: Any, name: str, instead: Callable[..., object]
) -> None:
    """Replace a function for this thread alone: threads of earlier tests go on with theirs."""
    real, here = getattr(owner, name), threading.get_ident()

    def called(*args: Any, **kwds: Any) -> object:
        return (instead if threading.get_ident() == here else real)(*args, **kwds)

    patch.setattr(owner, name, called)


class Gate:
    """Work that waits until it may go on; takes any arguments, as a callback."""

    def __init__(self) -> None:
        self.begun, self._go_on = threading.Event(), threading.Event()

    def __call__(self, *_: object) -> None:
        self.begun.set()
        wait_for(self._go_on)

    def open(self) -> None:
        self._go_on.set()


class HandClock(SimulatedClock):
    """A simulated clock that can be called for the time as well."""

    def __call__(self) -> float:
        return self.time


class SteppedClock(Clock):
    """Stands still until ``advance``. Threads that wait by it sleep until then, or are woken."""

    def __init__(self) -> None:
        self._now = 0.0
        self._sleeping: Dict[int, Tuple[threading.Condition, float]] = {}
        self._lock = threading.Lock()

    def now(self) -> float:
        return self._now

    def wait(self, condition: threading.Condition, seconds: Optional[float]) -> None:
        deadline = float("inf") if seconds is None else self._now + seconds
        thread = threading.get_ident()
        with self._lock:
            self._sleeping[thread] = (condition, deadline)
        condition.wait()
        with self._lock:
            self._sleeping.pop(thread, None)

    def settle(self, threads: int = 1) -> None:
        """Wait until so many threads sleep, and none of them is about to wake up."""
        eventually(lambda: self._asleep() == threads, 0.0005)

    def _asleep(self) -> int:
        with self._lock:
            sleeping = [condition for condition, _ in self._sleeping.values()]
        return min(len(sleeping), sum(len(each._waiters) for each in {*sleeping}))  # type: ignore[attr-defined]

    def advance(self, seconds: float, threads: int = 1) -> None:
        """Move on from deadline to deadline, each once so many threads sleep."""
        end = self._now + seconds
        while True:
            self.settle(threads)
            with self._lock:
                self._now = min([end, *(deadline for _, deadline in self._sleeping.values())])
                due = [key for key, (_, when) in self._sleeping.items() if when <= self._now]
                conditions = [self._sleeping.pop(key)[0] for key in due]
            for condition in conditions:
                with condition:
                    condition.notify_all()
            if not due:
                return
