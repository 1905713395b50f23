# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The parts of Python that belong to a process, as the code in a sandbox sees them.

Waits end at the unload, and threads are known. Effects on the whole process are limited to the
sandbox (its command line, its handlers of signals) or refused, with the cure.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import os
import queue
import signal
import sys
import threading
import time
from functools import partial
from typing import Any, Callable, Collection, Dict

from dyknow.errors import NeedsProcess
from dyknow.locks import flag_lock
from dyknow.nodelet.loading.importer import Importer, Module, View
from dyknow.periodic import NO_THREAD
from dyknow.ros.scripts.sandbox import Sandbox

Views = Dict[str, Callable[[], Module]]

#: Standard modules of which a sandbox has copies, since they use modules that are views.
COPIED = frozenset(("argparse", "optparse", "queue"))
#: Toolkits that work in the main thread of a process only.
_TOOLKITS = (
    "PyQt5 PyQt6 PySide2 PySide6 gi kivy pygame pynput python_qt_binding tkinter wx"
).split()
#: Where the keyboard can be read: a process that a manager starts has none.
_TERMINAL = "a terminal; run it in one with 'dyknow run'"
_REFUSED = {
    "cv2": "destroyAllWindows imshow namedWindow waitKey".split(),
    "multiprocessing": "Manager Pool Process get_context".split(),
    "os": [
        each for each in dir(os) if each in ("chdir", "fchdir") or each[:4] in ("exec", "fork")
    ],
    "signal": "alarm set_wakeup_fd setitimer".split(),
}


def process_views(sandbox: Sandbox) -> Views:
    """Return factories of the views that every sandbox has, by name."""
    calls = {"register": sandbox.exits.register, "unregister": sandbox.exits.unregister}
    views: Views = {"atexit": lambda: View(atexit, calls)}
    if not sandbox.is_alone:
        views["threading"] = lambda: _threading(sandbox)
        views["time"] = lambda: View(time, {"sleep": sandbox.pause})
        views["_queue"] = _queue
    return views


def script_views(sandbox: Sandbox, importer: Callable[[], Importer]) -> Views:
    """Return factories of the further views of a script, by name."""
    views: Views = {"sys": lambda: _Sys(sandbox, importer())}
    if not sandbox.is_alone:
        views.update(_refusing(sandbox))
        views["os"] = lambda: _partly_refused(
            sandbox,
            "os",
            _exit=sys.exit,
            kill=_kill(sandbox, os.kill, {os.getpid(), 0, -os.getpgrp()}),
            killpg=_kill(sandbox, os.killpg, {os.getpgrp(), 0}),
        )
        views["signal"] = lambda: _signal(sandbox)
    return views


def functions(sandbox: Sandbox, importer: Callable[[], Importer]) -> dict[str, Any]:
    """Return replacements of built-in functions."""
    if sandbox.is_alone:
        return {}

    def print_own(*words: Any, file: Any = None, **options: Any) -> None:
        """``print``, by default to the ``sys.stdout`` that the code may have set."""
        own: Any = importer().modules.get("sys", sys)
        print(*words, file=own.stdout if file is None else file, **options)

    refused = _refusal(sandbox, "input()", _TERMINAL)
    return {"input": refused, "exit": sys.exit, "quit": sys.exit, "print": print_own}


class _Sys(View):
    """``sys`` of a sandbox; assignments are to the process's ``sys`` if that is its own."""

    def __init__(self, sandbox: Sandbox, importer: Importer) -> None:
        own: dict[str, Any] = {"modules": importer.everything()}
        if not sandbox.is_alone:
            own.update(argv=sandbox.argv, path=importer.path, stdin=_NoKeyboard(sandbox))
        super().__init__(sys, own)
        self.__dict__.update(_sandbox=sandbox, _importer=importer)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(sys, name, value) if self._sandbox.is_alone else super().__setattr__(name, value)
        if name == "argv":
            self._sandbox.argv = value
        elif name == "path":
            self._importer.path = value

    def __delattr__(self, name: str) -> None:
        delattr(sys, name) if self._sandbox.is_alone else super().__delattr__(name)


def _queue() -> Module:
    """Return ``_queue`` without its ``SimpleQueue``: that of ``queue`` waits by ``threading``."""
    module = Module("_queue")
    vars(module)["Empty"] = queue.Empty
    return module


def _threading(sandbox: Sandbox) -> View:
    class Thread(threading.Thread):
        """A thread of a sandbox."""

        def __init__(self, *args: Any, daemon: bool | None = None, **kwds: Any) -> None:
            super().__init__(*args, daemon=daemon, **kwds)
            if daemon is None:
                self.daemon = sandbox.is_on_daemon()

        def start(self) -> None:
            sandbox.adopt(self)
            try:
                super().start()
            except NO_THREAD:
                sandbox.dismiss(self)
                raise

        def join(self, timeout: float | None = None) -> None:
            def is_over(seconds: float) -> bool:
                threading.Thread.join(self, seconds)
                return not self.is_alive()

            sandbox.wait_for(is_over, timeout)

    class Timer(threading.Timer, Thread):
        """A timer of a sandbox."""

        def __init__(self, *args: Any, **kwds: Any) -> None:
            super().__init__(*args, **kwds)
            self.daemon = sandbox.is_on_daemon()

    class Condition(threading.Condition):
        """A condition whose waits end at the unload."""

        _waiters: Any  # Python's own
        _is_owned: Callable[[], bool]
        _release_save: Callable[[], Any]
        _acquire_restore: Callable[[Any], None]

        def wait(self, timeout: float | None = None) -> bool:
            """Wait as Python does, for a lock that stays in line during all slices of the wait.

            With one for each slice, a notification that comes at the end of a slice would be lost.
            """
            if not self._is_owned():
                raise RuntimeError("cannot wait on un-acquired lock")
            waiter = flag_lock()  # free once it was notified
            waiter.acquire()
            self._waiters.append(waiter)
            saved, is_notified = self._release_save(), False
            try:
                is_notified = sandbox.wait_for(partial(waiter.acquire, True), timeout)
            finally:
                self._acquire_restore(saved)
                if not is_notified:
                    is_notified = waiter.acquire(False)  # meanwhile
                if not is_notified:
                    with contextlib.suppress(ValueError):  # an exception came after it was
                        self._waiters.remove(waiter)
            return is_notified

    def with_condition(base: type[Any]) -> type[Any]:
        def init(self: Any, *args: Any, **kwds: Any) -> None:
            base.__init__(self, *args, **kwds)
            self._cond = Condition(self._cond._lock)

        return type(base.__name__, (base,), {"__init__": init, "__doc__": base.__doc__})

    waiting = ("Event", "Semaphore", "BoundedSemaphore", "Barrier")
    own: dict[str, Any] = {each: with_condition(getattr(threading, each)) for each in waiting}
    own.update(Thread=Thread, Timer=Timer, Condition=Condition, main_thread=lambda: sandbox.main)
    view = View(threading, own)
    sandbox.thread_hook = lambda: vars(view).get("excepthook")
    return view


def _signal(sandbox: Sandbox) -> View:
    handlers: dict[int, Any] = {}

    def set_handler(number: int, handler: Any) -> Any:
        before = handlers.get(number, signal.SIG_DFL)
        handlers[number] = handler
        return before

    def tell() -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            handler = handlers.get(number)
            if callable(handler):
                with contextlib.suppress(SystemExit, KeyboardInterrupt):
                    handler(number, None)
                return

    def pause() -> None:
        sandbox.waits()
        sandbox.closing.wait()

    sandbox.on_signal = tell
    return _partly_refused(
        sandbox,
        "signal",
        signal=set_handler,
        getsignal=lambda number: handlers.get(number, signal.SIG_DFL),
        pause=pause,
        raise_signal=lambda number: sandbox.unload(),
    )


def _kill(
    sandbox: Sandbox, send: Callable[[int, int], None], own: Collection[int]
) -> Callable[[int, int], None]:
    """Return a function that sends signals; one to ``own`` processes ends the sandbox instead."""

    def kill(target: int, number: int) -> None:
        if target in own and number:
            sandbox.unload()
        else:
            send(target, number)

    return kill


def _refusing(sandbox: Sandbox) -> Views:
    """Return views of modules that code in a shared process must not use, or not entirely."""

    def refuse(toolkit: str) -> Callable[[], Module]:
        return lambda: _refusal(sandbox, f"the toolkit {toolkit}")()

    views: Views = {name: partial(_partly_refused, sandbox, name) for name in _REFUSED}
    return {**views, **{name: refuse(name) for name in _TOOLKITS}}


def _partly_refused(sandbox: Sandbox, name: str, **own: Any) -> View:
    real = importlib.import_module(name)
    refused = {
        call: _refusal(sandbox, f"{name}.{call}") for call in _REFUSED[name] if hasattr(real, call)
    }
    return View(real, {**refused, **own})


def _refusal(sandbox: Sandbox, *what: str) -> type[Any]:
    class Refused:
        """Stands for a function, or for a class that code may derive from."""

        def __new__(cls, *args: Any, **kwds: Any) -> Any:
            raise NeedsProcess(sandbox.name, *what)

        def __init_subclass__(cls, **kwds: Any) -> None:
            raise NeedsProcess(sandbox.name, *what)

    return Refused


class _NoKeyboard:
    """The standard input of a sandbox that shares its process."""

    def __init__(self, sandbox: Sandbox) -> None:
        self._sandbox = sandbox

    def isatty(self) -> bool:
        return False

    def __iter__(self) -> Any:
        return self.read

    __enter__ = __next__ = __iter__

    def __exit__(self, *unused: object) -> None:
        """Do nothing; it is not entered."""

    def __getattr__(self, name: str) -> Any:
        raise NeedsProcess(self._sandbox.name, "the keyboard (sys.stdin)", _TERMINAL)
