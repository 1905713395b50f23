# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What finalizers ask for, done later by a thread of its own.

Python may run a ``__del__`` in the middle of anything, also while the same thread holds a lock of
ours. Libraries withdraw their topics there, tf2's listeners do.
"""

from __future__ import annotations

import queue
import sys
from typing import Callable

from dyknow.periodic import attempt, in_background

_asked: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()


def begin() -> None:
    """Start the thread, if it is not there yet; finalizers themselves must start none."""
    global _is_running
    if not _is_running:
        _is_running = True
        in_background("what finalizers ask for", _run)


_is_running = False


def outside_of_finalizers(do: Callable[[], None]) -> None:
    """Do something that takes locks: now, or later if a finalizer asks for it."""
    if _is_in_finalizer():
        _asked.put(do)  # which may be called anywhere
    else:
        do()


def _is_in_finalizer() -> bool:
    frame = sys._getframe(1)
    while frame.f_back is not None:
        if frame.f_code.co_name == "__del__":
            return True
        frame = frame.f_back
    return False


def _run() -> None:
    while True:
        attempt("what a finalizer asked for", _asked.get())
