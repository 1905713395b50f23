"""A few threads for work that may wait for others."""

from __future__ import annotations

import logging
import queue
import threading
import time
from typing import Callable, List, Optional

_log = logging.getLogger("rosout.dyknow")


class Workers:
    """Does what it is given, in that order, some of it at the same time."""

    def __init__(self, count: int) -> None:
        """Start the threads."""
        self._work: queue.SimpleQueue[Optional[Callable[[], None]]] = queue.SimpleQueue()
        self._closed = False
        self._threads: List[threading.Thread] = [
            threading.Thread(target=self._run, name=f"worker {number}", daemon=True)
            for number in range(count)
        ]
        for thread in self._threads:
            thread.start()

    def run(self, work: Callable[[], None]) -> None:
        """Do it soon; returns at once."""
        self._work.put(work)

    def close(self, patience: float) -> None:
        """Begin nothing any more, and wait at most ``patience`` s for what was begun."""
        self._closed = True
        for _ in self._threads:
            self._work.put(None)
        deadline = time.monotonic() + patience
        for thread in self._threads:
            thread.join(max(0.0, deadline - time.monotonic()))

    def _run(self) -> None:
        while True:
            work = self._work.get()
            if work is None or self._closed:
                return
            try:
                work()
            except Exception:  # the boundary of the thread: the next work may do better
                _log.exception("work failed")
