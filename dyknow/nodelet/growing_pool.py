# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Threads for callbacks that may block for long, as those of unchanged scripts do.

Each strand that has something to do has a thread at once, as in rospy; one that is out of work
stays for a while.
"""

from __future__ import annotations

import threading
import time
from typing import List, Optional

from dyknow.locks import flag_lock
from dyknow.nodelet.crash_record import CrashRecord
from dyknow.nodelet.locking import message_lock
from dyknow.nodelet.scheduler import Executor, Strand

#: Seconds for which a thread without work stays.
_STAY = 5.0
_LOOK = 0.01


class _Thread:
    """One thread.

    Attributes:
        strand: what it is to run next; None to end.
        wake: taken while it sleeps, released to wake it.
    """

    def __init__(self, strand: Strand) -> None:
        self.strand: Optional[Strand] = strand
        self.wake = flag_lock()
        self.wake.acquire()


class GrowingPool(Executor):
    """As many threads as there are strands with work.

    Args:
        record: where its threads note whose code they run.
        stay: seconds for which a thread without work stays.
    """

    def __init__(self, record: Optional[CrashRecord] = None, stay: float = _STAY) -> None:
        super().__init__(record)
        self._stay = stay
        self._idle: List[_Thread] = []
        self._closed = False

    def ready(self, strand: Strand) -> None:
        """Hand the strand to a thread that is idle, else to a new one; the caller has the lock."""
        if self._closed:
            return
        if self._idle:
            thread = self._idle.pop()
            thread.strand = strand
            thread.wake.release()
        else:
            threading.Thread(
                target=self._work, args=(_Thread(strand),), name="dyknow-blocking", daemon=True
            ).start()

    def drain(self, timeout: float = 10.0) -> bool:
        """Wait until no strand has anything to do."""
        end = time.monotonic() + timeout
        while any(strand.busy for strand in list(self.strands) if strand.alive):
            if time.monotonic() >= end:
                return False
            time.sleep(_LOOK)
        return True

    def close(self) -> None:
        """End the threads that are idle; those that run a callback end with it."""
        with message_lock:
            self._closed = True
            idle, self._idle = self._idle, []
            for thread in idle:
                thread.wake.release()

    def _work(self, thread: _Thread) -> None:
        word = self.record.take()
        words = self.record.words
        while thread.strand is not None:
            strand, thread.strand = thread.strand, None
            words[word] = strand.mark
            self._run(strand)
            words[word] = 0
            del strand
            with message_lock:
                if self._closed:
                    break
                self._idle.append(thread)
            if not thread.wake.acquire(timeout=self._stay):
                with message_lock:
                    if thread in self._idle:
                        self._idle.remove(thread)
                    else:
                        thread.wake.acquire()  # it was woken just now
        self.record.give_back(word)

    @staticmethod
    def _run(strand: Strand) -> None:
        while True:
            with message_lock:
                task = strand.take()
                if task is None and strand.try_idle():
                    return
            if task is not None:
                strand.run(task)
