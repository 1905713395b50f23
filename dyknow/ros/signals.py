# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Signals, received by a thread that waits for nothing else.

Python runs a handler in the main thread once that thread executes Python code again. A main thread
that is just about to block misses a signal until something else wakes it up. The descriptor that
``signal.set_wakeup_fd`` names is written to at once, whatever the main thread does, so it is read
here.
"""

from __future__ import annotations

import os
import signal
from typing import Callable, Iterable

from dyknow.periodic import attempt, in_background


def on_signals(numbers: Iterable[int], told: Callable[[], None]) -> None:
    """Call ``told``, in a thread of its own, for each of these signals.

    Only the main thread may call this.
    """
    wanted = frozenset(numbers)
    readable, writable = os.pipe()
    os.set_blocking(writable, False)
    signal.set_wakeup_fd(writable, warn_on_full_buffer=False)
    for number in wanted:
        signal.signal(number, lambda *_: None)  # Python's own would raise, or end the process

    def listen() -> None:
        while True:
            for number in os.read(readable, 64):
                if number in wanted:
                    attempt("acting on a signal", told)

    # A forked process would write into the same pipe, and tell this one of its own signals.
    os.register_at_fork(after_in_child=lambda: _let_go(wanted))
    in_background("signals", listen)


def _let_go(numbers: Iterable[int]) -> None:
    signal.set_wakeup_fd(-1)
    for number in numbers:
        signal.signal(number, signal.SIG_DFL)
