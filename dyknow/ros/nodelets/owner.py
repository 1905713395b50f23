# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which DyKnow manager looks after a nodelet manager, and its end without one.

A DyKnow manager holds a lock on a file as long as it lives; the kernel releases the lock
at its death. Each of its nodelet managers waits for that lock: as long as the owner lives
the wait costs nothing, and its end is noticed at once. An owner that returns in time takes the
lock again. So there is no heartbeat, and a stopped owner is not a dead one.

Waiting nodelet managers get the lock for a moment when the owner dies, and one that is stopped
just then keeps it. So owners lock a second file too, which no other process locks: there is one
owner.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import signal
import sys
import time
from typing import Callable, Sequence, TextIO

from dyknow.errors import StoreError
from dyknow.periodic import PeriodicWorker, in_background
from dyknow.ros.process.os_process import ProcessId, only_for_owner

#: Seconds that an owner waits for its predecessor to be gone altogether.
_CONTENTION = 1.0
_STEP = 0.02
#: Seconds between two looks for an owner that returns, at most.
_LOOK = 1.0
#: Seconds that a nodelet manager without an owner has to end by itself.
PATIENCE = 3.0


class OwnerLock:
    """The owner's side; nodelet managers get the name of the file.

    Raises:
        StoreError: another owner has it, or the file cannot be made.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        try:
            os.makedirs(os.path.dirname(path), 0o700, exist_ok=True)
            self._owners = _made(path + ".owner")
            self._waiting = _made(path)
        except OSError as error:
            raise StoreError(path, error) from error
        deadline = time.monotonic() + _CONTENTION
        while not _lock(self._owners, fcntl.LOCK_EX | fcntl.LOCK_NB):
            if time.monotonic() > deadline:
                self.release()
                raise StoreError(path, "another manager of that name uses it")
            time.sleep(_STEP)
        if not _lock(self._waiting, fcntl.LOCK_EX | fcntl.LOCK_NB):
            in_background("owner", self._take_later)

    def release(self) -> None:
        self._owners.close()
        self._waiting.close()

    def _take_later(self) -> None:
        """Wait for nodelet managers that just find out that the predecessor is gone."""
        with contextlib.suppress(ValueError):  # released before
            _lock(self._waiting, fcntl.LOCK_EX)


def wait_until_orphaned(path: str, timeout: float) -> None:
    """Return when there was no owner at any look in ``timeout`` seconds, and after them."""
    looks = math.ceil(timeout / _LOOK)
    while True:
        with contextlib.suppress(FileNotFoundError), open(path) as file:
            _lock(file, fcntl.LOCK_SH)  # blocks as long as there is an owner
        for _ in range(looks):
            time.sleep(timeout / looks)
            if is_taken(path):
                break
        else:
            return


def is_taken(path: str) -> bool:
    """Whether a process has the lock; False where there is no such file."""
    try:
        with open(path + ".owner") as file:
            return not _lock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return False


def _made(path: str) -> TextIO:
    """Open a file to be locked; it is made if need be, but may be on a read-only disk as well.

    Only its owner may open it, and so hold the lock.
    """
    try:
        file = open(path, "a", opener=only_for_owner)  # noqa: SIM115 - it is kept open
        os.chmod(path, 0o600)
        return file
    except OSError:
        if not os.path.exists(path):
            raise
        return open(path)


def _lock(file: TextIO, operation: int) -> bool:
    try:
        fcntl.flock(file, operation)
    except BlockingIOError:
        return False
    return True


def end_when_orphaned(path: str, timeout: float, end: Callable[[], None]) -> None:
    """Call ``end`` from a thread of its own once there was no owner for ``timeout`` s."""

    def watch() -> None:
        wait_until_orphaned(path, timeout)
        worker.close()
        end()

    worker = PeriodicWorker("waiting for the owner's end", watch, 0.0)
    worker.start()


def main(argv: Sequence[str]) -> int:
    """Watch over a process that cannot do so itself: ``owner.py LOCK SECONDS PID``."""
    path, timeout, pid = argv[1:]
    watched = ProcessId.of(int(pid))
    if watched is None:
        return 0
    # It must not end with the session's terminal, but with the process that it watches.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_when_orphaned(path, float(timeout), lambda: watched.end(PATIENCE))
    watched.wait()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv))
