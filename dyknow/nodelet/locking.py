# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The one lock that every message passes under.

Strands, connections and publications guard their state with the same lock instead of one each. A
message mostly comes after a pause, when little of what it touches is in the processor's caches:
with locks of their own, a hop spent a third of its time on fetching these.

What is done under the lock takes about a microsecond, and no code of a nodelet is called there. So
it is contended only if its holder has to hand over the interpreter in the middle. A thread that
finds it taken lets others run until it is free, instead of queueing up: a thread that waits in a
queue is given the lock while it has no interpreter, and then all stand in line at every message (a
sixth of the throughput was left). It is reentrant since a signal handler or a finalizer that
publishes may come in between.
"""

from __future__ import annotations

import time

from dyknow.locks import reentrant_state_lock


class MessageLock:
    """A reentrant lock for short work.

    Where every message passes, its parts are used instead of ``with``, which costs twice as much::

        if not attempt(False):
            wait()
        try:
            ...
        finally:
            leave()
    """

    def __init__(self) -> None:
        lock = reentrant_state_lock("messages")
        self.attempt = lock.acquire
        self.leave = lock.release

    def wait(self) -> None:
        """Take the lock after others have finished."""
        while not self.attempt(False):
            time.sleep(0)

    def __enter__(self) -> None:
        """Take the lock."""
        self.wait()

    def __exit__(self, *unused: object) -> None:
        """Release the lock."""
        self.leave()


message_lock = MessageLock()
