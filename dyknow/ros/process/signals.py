# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Signals, received by a thread that waits for nothing else; and the exit codes of processes.

Python runs a handler in the main thread once that thread executes Python code again. A main thread
that is just about to block misses a signal until something else wakes it up. The descriptor that
``signal.set_wakeup_fd`` names is written to at once, even if the main thread blocks, so it is read
here.
"""

from __future__ import annotations

import _thread
import contextlib
import os
import signal
import sys
import threading
import time
from typing import Any, Callable, Iterable, Iterator

from dyknow.periodic import attempt, in_background

# Exit codes, those of nodelet_core's `nodelet`:

#: Done, stopped on request, or no longer needed because the bond broke.
DONE = 0
#: A request was refused, or an argument is wrong; nodelet_core returns -1.
FAILED = 255
#: Stopped before it could do its work; as a shell shows for SIGINT.
INTERRUPTED = 130

#: Signals that end a command as SIGINT does, from a supervisor and from a terminal that is closed.
ENDING = (signal.SIGTERM, signal.SIGHUP)
_AGAIN = 0.05  # s
#: Seconds between two looks at the system's clock, and the least step back that is acted on.
_LOOK, _STEP = 0.25, 0.1
#: Ignored unless it is handled; no part of ROS uses it.
_NUDGE = signal.SIGURG
#: Set when `raise_interrupt` raises; cleared when that is seen, and at the end of `sigint`.
_raised = threading.Event()


class _Interrupt(KeyboardInterrupt):
    """Ends a command. One that does not reach our code is sent again.

    Python drops, without a word, what is raised in a method that a finalizer in C calls, such as
    ``close`` of an answer of ``http.client``.
    """

    def __del__(self) -> None:
        if signal.getsignal(signal.SIGINT) is not raise_interrupt:
            return  # it has left `sigint`
        trace = self.__traceback__
        # The first frame of its trace is the last one that it has come to.
        if trace is None or not trace.tb_frame.f_globals.get("__name__", "").startswith("dyknow"):
            _send_again(signal.SIGINT, _raised.is_set)


def raise_interrupt(number: int, frame: Any) -> None:
    """Raise KeyboardInterrupt; while a module is imported, once that is done.

    Modules are loaded with callbacks that print an exception and drop it. After any signal but
    SIGINT, those of `ENDING` are ignored: a terminal that is closed sends SIGHUP twice, and a
    session that ends SIGTERM as well; the second must not stop what then cleans up.
    """
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            _send_again(number)
            return
        frame = frame.f_back
    if number != signal.SIGINT:
        for each in (number, *ENDING):
            if signal.getsignal(each) is raise_interrupt:
                # Python warns of a signal that has come already if SIG_IGN takes its handler.
                signal.signal(each, lambda number, frame: None)
    _raised.set()
    raise _Interrupt


def _send_again(number: int, is_wanted: Callable[[], bool] = lambda: True) -> None:
    """Send a signal to this thread again, a little later, if it is wanted then."""
    # A thread of ``threading`` takes a lock that the interrupted code may hold.
    _thread.start_new_thread(_send, (threading.get_ident(), number, is_wanted))


def _send(thread: int, number: int, is_wanted: Callable[[], bool]) -> None:
    time.sleep(_AGAIN)
    if is_wanted():
        signal.pthread_kill(thread, number)


def raise_swallowed() -> None:
    """Raise KeyboardInterrupt again if a library has caught one that a signal raised."""
    if _raised.is_set():
        _raised.clear()
        raise KeyboardInterrupt


@contextlib.contextmanager
def sigint(handler: Any, *others: int) -> Iterator[None]:
    """Handle SIGINT and other signals so, except those that are ignored; as before at the end."""
    _raised.clear()
    former = {number: signal.getsignal(number) for number in (signal.SIGINT, *others)}
    former = {each: before for each, before in former.items() if before is not signal.SIG_IGN}
    try:
        for number in former:
            signal.signal(number, handler)
        yield
    finally:
        _raised.clear()
        for number, before in former.items():
            signal.signal(number, before)


def on_signals(numbers: Iterable[int], act: Callable[[], None]) -> None:
    """Call ``act``, in a thread of its own, for each of these signals.

    Handlers that were set before are called as well, except Python's own, which would raise. One
    that is set later takes the place of this. Only the main thread may call this.
    """
    wanted = frozenset(numbers)
    readable, writable = os.pipe()
    os.set_blocking(writable, False)
    before = {number: signal.getsignal(number) for number in wanted}

    def handle(number: int, frame: Any) -> None:
        # Code that runs an event loop of its own may have taken the wakeup descriptor.
        with contextlib.suppress(BlockingIOError):
            os.write(writable, bytes([number]))
        earlier = before[number]
        if callable(earlier) and earlier is not signal.default_int_handler:
            earlier(number, frame)

    signal.set_wakeup_fd(writable, warn_on_full_buffer=False)
    for number in wanted:
        signal.signal(number, handle)

    def listen() -> None:
        while True:
            for number in os.read(readable, 64):
                if number in wanted and signal.getsignal(number) is handle:
                    attempt("acting on a signal", act)

    def let_go() -> None:
        """Leave a forked process alone: it would write into the same pipe."""
        signal.set_wakeup_fd(-1)
        for number in wanted:
            if signal.getsignal(number) is handle:
                signal.signal(number, signal.SIG_DFL)

    os.register_at_fork(after_in_child=let_go)
    in_background("signals", listen)


def keep_waits_steady() -> None:
    """Let steps of the system's clock lengthen no wait; only the main thread may call this.

    Before Python 3.9 a wait with a time limit ends at a moment of that clock: set back by a
    minute, as by NTP at boot, it would hold up leases, polls and timers for a minute. A thread
    that gets a signal reckons the rest of its wait by the steady clock.
    """
    if sys.version_info < (3, 9):
        signal.signal(_NUDGE, lambda number, frame: None)
        in_background("clock", _follow_clock)


def _follow_clock() -> None:
    before = time.time() - time.monotonic()
    while True:
        time.sleep(_LOOK)
        before = nudge_after_step(before)


def nudge_after_step(before: float) -> float:
    """Make all threads reckon their waits anew if the clock was set back.

    ``before`` is the time by which it was ahead of the steady clock at the last look; the present
    one is returned.
    """
    ahead = time.time() - time.monotonic()
    if ahead < before - _STEP:
        known: Any = threading
        with known._active_limbo_lock:  # no thread of Python's ends meanwhile
            for each in known._active.values():
                if not isinstance(each, known._DummyThread):
                    signal.pthread_kill(each.ident, _NUDGE)
    return ahead
