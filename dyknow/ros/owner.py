"""Who looks after a nodelet manager, and what happens when nobody does.

A DyKnow manager holds a lock on a file as long as it lives; the kernel gives the lock back
whatever kills it. Each of its nodelet managers waits for that lock: as long as the owner lives
the wait costs nothing, and its end is noticed at once. An owner that returns in time takes the
lock again. So there is no heartbeat, a stopped owner is not a dead one, and one file has one
owner.
"""

from __future__ import annotations

import fcntl
import os
import signal
import sys
import threading
import time
from typing import Callable, Sequence

from dyknow.errors import StoreError
from dyknow.ros.process import ProcessId

#: Seconds that an owner waits for those who just find out that its predecessor is gone.
_CONTENTION = 1.0
_STEP = 0.02
#: Seconds that a nodelet manager without an owner has to end by itself.
PATIENCE = 3.0


class OwnerLock:
    """The owner's side."""

    def __init__(self, path: str) -> None:
        """Take the lock.

        Raises:
            StoreError: another owner has it, or the file cannot be made.
        """
        self.path = path
        try:
            os.makedirs(os.path.dirname(path), exist_ok=True)
            self._file = open(path, "a")  # noqa: SIM115
        except OSError as error:
            raise StoreError(path, error) from error
        deadline = time.monotonic() + _CONTENTION
        while True:
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except OSError as error:
                if time.monotonic() > deadline:
                    self._file.close()
                    raise StoreError(path, "another manager of that name uses it") from error
                time.sleep(_STEP)

    def release(self) -> None:
        """Give the lock back."""
        self._file.close()


def wait_until_orphaned(path: str, timeout: float) -> None:
    """Return when the lock was free for ``timeout`` seconds."""
    while True:
        with open(path) as file:
            fcntl.flock(file, fcntl.LOCK_SH)  # blocks as long as there is an owner
        time.sleep(timeout)
        with open(path) as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
                return
            except OSError:
                continue  # the owner is back


def end_when_orphaned(path: str, timeout: float, end: Callable[[], None]) -> None:
    """Call ``end`` from a thread of its own once nobody has looked after us for ``timeout`` s."""

    def watch() -> None:
        try:
            wait_until_orphaned(path, timeout)
        except OSError:
            return  # the file is gone: there is nobody to wait for
        end()

    threading.Thread(target=watch, name="owner", daemon=True).start()


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
