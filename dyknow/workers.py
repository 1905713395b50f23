# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A pool of threads for work that may wait for others."""

from __future__ import annotations

import queue
import time
from typing import Callable, Optional

from dyknow.periodic import attempt, in_background


class Workers:
    """A few daemon threads on one queue: work begins in the order in which it was handed over."""

    def __init__(self, what: str, count: int) -> None:
        """Start the threads.

        Args:
            what: what the work is, for the log and as the name of the threads.
            count: how many pieces of work are done at the same time.
        """
        self._what = what
        self._queue: queue.SimpleQueue[Optional[Callable[[], object]]] = queue.SimpleQueue()
        self._closed = False
        self._threads = [in_background(f"{what} {n}", self._run) for n in range(count)]

    def run(self, work: Callable[[], object]) -> None:
        """Have something done soon; does not wait for it."""
        self._queue.put(work)

    def close(self, timeout: float = 0.0) -> None:
        """Begin no further work; wait at most ``timeout`` s for what was begun."""
        self._closed = True
        for _ in self._threads:
            self._queue.put(None)
        deadline = time.monotonic() + timeout
        for thread in self._threads:
            thread.join(max(0.0, deadline - time.monotonic()))

    def _run(self) -> None:
        while True:
            work = self._queue.get()
            if work is None or self._closed:
                return
            attempt(self._what, work)
