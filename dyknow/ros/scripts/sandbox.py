# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Sandboxes: rospy code that is written for a process of its own, run as one of many nodelets.

The code is a script, or the libraries of rospy that a nodelet uses. Its sandbox has its
handle, threads and shutdown hooks, and ends them all when the nodelet is unloaded.
"""

from __future__ import annotations

import collections
import ctypes
import logging
import math
import queue
import sys
import threading
import time
import traceback
import weakref
from functools import partial
from types import FrameType
from typing import Any, Callable, Collection, Iterable, Mapping

from dyknow.errors import NeedsProcess
from dyknow.locks import flag_lock, state_lock
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.nodelet.middleware import Closable
from dyknow.periodic import attempt, current_frames, in_background

#: Seconds from the end of the hooks in which threads may end by themselves.
_PATIENCE = 0.3
#: Seconds in which they are made to end, from then on.
_FORCE = 0.45
#: Seconds that shutdown hooks may sleep during an unload.
HOOKS_PATIENCE = 0.25
_STEP = 0.02
#: Seconds for which threads sleep that still run then, each time that they wait for something.
_AFTERWARDS = 1.0
#: Seconds of a slice of a wait.
_SLICE = 0.1
#: Sleeps that the end cuts short before it ends a thread; of one that calls hooks, many.
_SLEEPS, _SLEEPS_IN_HOOKS = 1, 1000
#: Threads after which those that have ended are forgotten.
_MANY = 32

_log = logging.getLogger("rosout.dyknow")


_deferred: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
_is_deferring = False


def _do_nothing() -> None:
    """Do nothing."""


def defer_in_finalizers() -> None:
    """Start the thread of ``outside_of_finalizers``; finalizers themselves must start none."""
    global _is_deferring
    if not _is_deferring:
        in_background("calls of finalizers", _call_deferred)
        _is_deferring = True


def _call_deferred() -> None:
    while True:
        attempt("the call of a finalizer", _deferred.get())


def outside_of_finalizers(call: Callable[[], None]) -> None:
    """Make a call that takes locks: now, or in another thread if a finalizer asks for it.

    Python may run a ``__del__`` in the middle of anything, also while the same thread holds a lock
    of ours. Libraries withdraw their topics there, as tf2's listeners do.
    """
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if frame.f_code.co_name == "__del__":
            _deferred.put(call)  # which may be called anywhere
            return
        frame = frame.f_back
    call()


class Exits:
    """Stands in for ``atexit``."""

    def __init__(self) -> None:
        self.calls: list[tuple[Callable[..., Any], Callable[[], Any]]] = []

    def register(self, call: Callable[..., Any], *args: Any, **kwds: Any) -> Callable[..., Any]:
        self.calls.append((call, partial(call, *args, **kwds)))
        return call

    def unregister(self, call: Callable[..., Any]) -> None:
        self.calls = [each for each in self.calls if each[0] != call]


class Sandbox:
    """One sandbox; every method is safe from any thread.

    Attributes:
        name: its name in the log.
        handle: its node handle; None until a script in a process of its own has called
            ``rospy.init_node``.
        is_alone: whether the process is its own.
        copies: whether it receives and sends copies of messages.
        argv: its command line, the program first; the code may change it.
        mappings: the remappings of its command line, as they are written there.
        closing: set when its code is to end.
        settled: set when its main thread waits for the first time, or has ended.
        threads: the threads that its code started.
        on_refusal: called when a refused call ends a thread or a callback.
        on_signal: called when an unload ends its code, as a signal would.
        thread_hook: returns the ``threading.excepthook`` that its code has set, or None.
        main: its main thread; None for libraries.
    """

    def __init__(
        self,
        name: str,
        main: threading.Thread | None = None,
        is_alone: bool = False,
        copies: bool = True,
    ) -> None:
        defer_in_finalizers()
        self.name = name
        self.main = main
        self.is_alone = is_alone
        self.copies = copies
        self.argv: list[str] = sys.argv
        self.mappings: Mapping[str, str] = {}
        self.handle: PlainNodeHandle | None = None
        self.closing = threading.Event()
        self.settled = threading.Event()
        self.threads: list[threading.Thread] = []
        self.on_refusal: Callable[[NeedsProcess], None] = lambda refusal: None
        self.on_signal: Callable[[], None] = _do_nothing
        self.thread_hook: Callable[[], Any] = _do_nothing
        #: Shutdown hooks, by phase: on_shutdown, pre-shutdown and shutdown.
        self.hooks: list[Callable[[], None]] = []
        self.hooks_before: list[Callable[[str], None]] = []
        self.hooks_after: list[Callable[[str], None]] = []
        self.exits = Exits()
        #: Its topics and services, which refer to its callbacks.
        self.ends: weakref.WeakSet[Any] = weakref.WeakSet()
        self.is_ending = False
        #: Threads that call hooks, handlers of signals or ``atexit`` functions.
        self._in_hooks: set[threading.Thread] = set()
        self._end_of_sleep = math.inf
        self._lock = state_lock("sandbox")
        self._waiting: list[Callable[[PlainNodeHandle], None]] = []
        self._non_daemons: weakref.WeakSet[threading.Thread] = weakref.WeakSet()
        #: Sleeps that were cut short, by thread.
        self._released: collections.Counter[int] = collections.Counter()
        self._is_over = False

    @property
    def context(self) -> Context | None:
        """Its share of the runtime; None while it has no handle."""
        return self.handle.context if self.handle is not None else None

    def begin(self, handle: PlainNodeHandle) -> None:
        """Set the handle, and make the calls that waited for it."""
        with self._lock:
            self.handle = handle
            waiting, self._waiting = self._waiting, []
        for each in waiting:
            each(handle)

    def with_handle(self, do: Callable[[PlainNodeHandle], None]) -> None:
        """Call ``do`` with the handle, as soon as there is one."""
        with self._lock:
            if self.handle is None:
                self._waiting.append(do)
                return
        do(self.handle)

    def signal_shutdown(self, reason: str) -> None:
        """Shut down because the code asks for it, and unload then; once."""
        if self.shut_down(reason, waits=False):
            self.unload()

    def unload(self, why: str = "") -> None:
        """Unload the nodelet, from a thread of its own, once its load is complete.

        ``why`` says, for the log, why the code has ended by itself.
        """
        if why:
            self.on_signal = _do_nothing
        context = self.context
        if context is None:
            return
        if self.is_alone:  # no load waits for it
            in_background(f"unloading {self.name}", context.unload)
            return

        def begin() -> None:
            if why:
                _log.info("%s: %s", self.name, why)
            in_background(f"unloading {self.name}", context.unload)

        context.new_strand("its end").post(begin)  # whatever its callbacks do

    def is_on_daemon(self) -> bool:
        """Whether the current thread would be a daemon in a process of its own."""
        me = threading.current_thread()
        return me.daemon and me is not self.main and me not in self._non_daemons

    def adopt(self, thread: threading.Thread) -> None:
        """Register a thread that is about to start, and make it a daemon."""
        with self._lock:
            if len(self.threads) > _MANY:
                self.threads = [t for t in self.threads if t.ident is None or t.is_alive()]
            self.threads.append(thread)
        if not thread.daemon:
            self._non_daemons.add(thread)
            thread.daemon = True
        run, context = thread.run, self.context
        if context is not None:

            def noted() -> None:
                with context.executor.record.noting(context.mark):
                    try:
                        self.call(run)
                    except Exception:
                        hook = self.thread_hook()
                        if hook is None:
                            raise
                        hook(threading.ExceptHookArgs((*sys.exc_info(), thread)))

            thread.run = noted  # type: ignore[method-assign]

    def dismiss(self, thread: threading.Thread) -> None:
        """Forget a thread that could not be started."""
        with self._lock:
            is_known = thread.ident is None and thread in self.threads
            if is_known:
                self.threads.remove(thread)
        if is_known:
            self._non_daemons.discard(thread)
            vars(thread).pop("run", None)

    def call(self, callback: Callable[..., Any], *args: Any) -> Any:
        """Call a callback of the code; a refused call in it ends the sandbox as a whole."""
        try:
            return callback(*args)
        except NeedsProcess as refusal:
            self.on_refusal(refusal)
            raise

    def join(self) -> None:
        """Wait for the threads that were not daemons, as Python does at its end."""
        self.waits()
        join_all(lambda: [each for each in list(self.threads) if each in self._non_daemons])

    def rest(self, seconds: float) -> bool:
        """Sleep until ``seconds`` pass or the sandbox is closing; return whether it is closing."""
        self.waits()
        if threading.current_thread() in self._in_hooks:
            seconds = min(seconds, self._end_of_sleep - time.monotonic())
        ends = self.closing.wait(max(0.0, seconds))
        if self._is_over:  # it is late, or catches SystemExit: that would spin
            time.sleep(_AFTERWARDS)
        return ends

    def pause(self, seconds: float) -> None:
        """Sleep until ``seconds`` pass or the sandbox is closing.

        The first sleep of a thread that the end cuts short returns, so that loops which check
        ``rospy.is_shutdown`` end in order. In hooks and ``atexit`` functions the later ones do
        too, unless they never end.

        Raises:
            SystemExit: a later sleep of the thread is cut short. In a process of its own every
                sleep returns, as in rospy.
        """
        if not self.rest(seconds) or self.is_alone:
            return
        is_in_hooks = threading.current_thread() in self._in_hooks
        thread = threading.get_ident()
        self._released[thread] += 1
        if self._released[thread] > (_SLEEPS_IN_HOOKS if is_in_hooks else _SLEEPS):
            raise SystemExit

    def waits(self) -> None:
        """Note that the code waits, so its load need not take any longer."""
        if threading.current_thread() is self.main:
            self.settled.set()

    def wait_for(self, condition: Callable[[float], bool], timeout: float | None) -> bool:
        """Wait in short slices, so that an unload ends the wait.

        Args:
            condition: waits at most so many seconds, and returns whether it came true. It is not
                called again then.
            timeout: seconds to wait at most; None for any time.

        In hooks and ``atexit`` functions the end of the sandbox ends the wait as a timeout does.

        Raises:
            SystemExit: the sandbox is to end.
        """
        self.waits()
        end = None if timeout is None else time.monotonic() + timeout
        while True:
            left = _SLICE if end is None else min(_SLICE, end - time.monotonic())
            if condition(max(0.0, left)):
                return True
            if end is not None and time.monotonic() >= end:
                return False
            if self.closing.is_set():
                if condition(0.0):
                    return True
                self.pause(0.0)
                if threading.current_thread() in self._in_hooks:
                    return False

    # The end

    def shut_down(self, reason: str, patience: float = math.inf, waits: bool = True) -> bool:
        """Shut down as rospy does: hooks, the flag that loops check, hooks.

        Args:
            reason: passed to the hooks.
            patience: seconds for which the hooks may sleep; sleeps end then and the hooks go on,
                so that a robot's driver sends its last commands all the same.
            waits: for the flag, if another thread shuts down already. Code of the sandbox must
                not: a hook may wait for its thread.

        Returns:
            Whether it was not shut down before.
        """
        with self._lock:
            is_first = not self.is_ending
            if is_first:
                self.is_ending = True
                self._end_of_sleep = time.monotonic() + patience
        if not is_first:
            if waits and threading.current_thread() not in self._in_hooks:  # else one asks again
                self.closing.wait()
            return False
        for hook in list(self.hooks):
            self._attempt(hook, "on_shutdown")
        for before in list(self.hooks_before):
            self._attempt(partial(before, reason), "a shutdown hook")
        self.closing.set()
        for after in list(self.hooks_after):
            self._attempt(partial(after, reason), "a shutdown hook")
        return True

    def end_threads(self, files: Collection[str]) -> None:
        """End its threads: wait for them, then raise ``SystemExit`` in them where that is safe.

        It is raised only while a thread runs code of its own modules, from these source files:
        elsewhere the thread might leave a lock held.
        """
        began = time.monotonic()
        me = threading.current_thread()
        mine = [
            each for each in [self.main, *self.threads] if each and each is not me and each.ident
        ]
        for thread in mine:
            if isinstance(thread, threading.Timer):
                thread.cancel()
        for thread in mine:
            # Not its own ``join``, which is for the sandbox's threads.
            threading.Thread.join(thread, max(0.0, began + _PATIENCE - time.monotonic()))
        while True:
            mine = [each for each in mine if each.is_alive()]
            if not mine:
                return
            if time.monotonic() >= began + _PATIENCE + _FORCE:
                break
            for thread in mine:
                if _place(thread)[0] in files:
                    _raise_exit(thread)
            time.sleep(_STEP)
        self._is_over = True
        if self.context is not None:
            self.context.late_threads += mine
        for thread in mine:
            where = ":".join(map(str, _place(thread)))
            _log.warning(
                "%s: thread '%s' does not end; it is at %s", self.name, thread.name, where
            )

    def run_exits(self) -> None:
        """Make the calls that were registered with ``atexit``."""
        while self.exits.calls:  # the last first; one of them may register more
            self._attempt(self.exits.calls.pop()[1], "atexit")

    def let_go(self) -> None:
        """Drop all callbacks at the end, so that no reference cycle keeps its objects."""
        for end in list(self.ends):
            end.let_go()
        for hooks in (self.hooks, self.hooks_before, self.hooks_after):
            hooks.clear()
        self.on_refusal = lambda refusal: None
        self.on_signal = self.thread_hook = _do_nothing
        for thread in [each for each in self.threads if not each.is_alive()]:
            vars(thread).pop("run", None)
            vars(thread).pop("_callback", None)  # of a ``rospy.Timer``

    def _attempt(self, call: Callable[[], Any], what: str) -> None:
        me = threading.current_thread()
        self._in_hooks.add(me)
        try:
            call()
        except BaseException:  # the boundary: the other hooks, and the unload, go on
            _log.error("%s: %s raised\n%s", self.name, what, traceback.format_exc())
        finally:
            self._in_hooks.discard(me)


class SandboxEnd(Closable):
    """Ends a sandbox together with its nodelet, also with one whose load fails.

    ``files`` returns the source files of the sandbox's own modules.
    """

    def __init__(self, sandbox: Sandbox, files: Callable[[], Iterable[str]]) -> None:
        self._sandbox = sandbox
        self._files = files
        self._begun = flag_lock()

    def in_order(self, patience: float = math.inf) -> None:
        """Shut it down with its hooks, which may sleep for ``patience`` seconds, and end it."""
        if self._sandbox.shut_down("unloaded", patience):
            self._sandbox._attempt(self._sandbox.on_signal, "a handler of signals")
        if self._begun.acquire(False):
            self._end()

    def close(self) -> None:
        """End it in the background unless it ends in order: its load failed, or hooks hang."""
        self._sandbox.closing.set()
        if self._begun.acquire(False):
            thread = in_background(f"end of {self._sandbox.name}", self._end)
            if self._sandbox.context is not None:
                self._sandbox.context.late_threads.append(thread)  # memory is freed after it

    def _end(self) -> None:
        self._sandbox.end_threads(frozenset(self._files()))
        self._sandbox.run_exits()


def join_all(threads: Callable[[], Iterable[threading.Thread]]) -> None:
    """Wait until no other thread of these is alive, nor one that they have started meanwhile."""
    me = threading.current_thread()
    while True:
        left = [each for each in threads() if each is not me and each.is_alive()]
        if not left:
            return
        left[0].join()


def _place(thread: threading.Thread) -> tuple[str, int]:
    """The source file and the line that a thread is at."""
    frame = current_frames().get(thread.ident or 0)
    return ("?", 0) if frame is None else (frame.f_code.co_filename, frame.f_lineno)


def _raise_exit(thread: threading.Thread) -> None:
    ctypes.pythonapi.PyThreadState_SetAsyncExc(
        ctypes.c_ulong(thread.ident or 0), ctypes.py_object(SystemExit)
    )
