# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The parts of Python that belong to a process, as a guest sees them.

Waits end at the unload, threads are known, and what would take effect on the whole process is the
guest's own (its command line, its handlers of signals) or refused, with the cure.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib
import os
import signal
import sys
import threading
import time
from typing import Any, Callable, Dict, NoReturn, Optional, Type

from dyknow.errors import NeedsProcess
from dyknow.nodelet.importer import Importer, Module, View
from dyknow.ros.scripts.guest import Guest

Views = Dict[str, Callable[[], Module]]

#: Modules of Python's own library of which a guest has copies, since they look at what is viewed.
COPIED = frozenset(("argparse", "optparse", "queue"))
#: Toolkits that work in the main thread of a process only.
_TOOLKITS = (
    "PyQt5 PyQt6 PySide2 PySide6 gi kivy pygame pynput python_qt_binding tkinter wx"
).split()
_REFUSED = {
    "cv2": "destroyAllWindows imshow namedWindow waitKey".split(),
    "multiprocessing": "Manager Pool Process get_context".split(),
    "os": "chdir execl execv execve execvp fchdir fork forkpty".split(),
    "signal": "alarm set_wakeup_fd setitimer".split(),
}


def process_views(guest: Guest) -> Views:
    """Return what makes the views that every guest has, by name."""
    views: Views = {
        "atexit": lambda: View(
            atexit, {"register": guest.exits.register, "unregister": guest.exits.unregister}
        ),
    }
    if not guest.is_alone:
        views["threading"] = lambda: _threading(guest)
        views["time"] = lambda: View(time, {"sleep": guest.pause})
    return views


def script_views(guest: Guest, importer: Callable[[], Importer]) -> Views:
    """Return what makes the further views of a script, by name.

    Args:
        guest: whose they are.
        importer: returns what has its modules.
    """
    views: Views = {"sys": lambda: _sys(guest, importer())}
    if not guest.is_alone:
        views.update(_refusing(guest))
        views["os"] = lambda: _partly_refused(guest, "os", _exit=sys.exit, kill=_kill(guest))
        views["signal"] = lambda: _signal(guest)
    return views


def functions(guest: Guest) -> Dict[str, Any]:
    """What takes the place of built-in functions."""
    if guest.is_alone:
        return {}
    return {"input": _refusal(guest, "input()"), "exit": sys.exit, "quit": sys.exit}


def _sys(guest: Guest, importer: Importer) -> View:
    if guest.is_alone:
        return _OwnSys(guest, importer)
    return View(
        sys,
        {
            "argv": guest.argv,
            "path": importer.path,
            "modules": importer.everything(),
            "stdin": _NoKeyboard(guest),
        },
    )


class _OwnSys(View):
    """``sys`` of a guest with a process of its own: what it sets there is the process's."""

    def __init__(self, guest: Guest, importer: Importer) -> None:
        super().__init__(sys, {"modules": importer.everything()})
        self.__dict__.update(_guest=guest, _importer=importer)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(sys, name, value)
        if name == "argv":
            self._guest.argv = value
        elif name == "path":
            self._importer.path = value

    def __delattr__(self, name: str) -> None:
        delattr(sys, name)


def _threading(guest: Guest) -> View:
    class Thread(threading.Thread):
        """A thread of a guest."""

        def start(self) -> None:
            guest.adopt(self)
            super().start()

        def join(self, timeout: Optional[float] = None) -> None:
            def is_over(seconds: float) -> bool:
                threading.Thread.join(self, seconds)
                return not self.is_alive()

            guest.wait_for(is_over, timeout)

    class Timer(threading.Timer, Thread):
        """A timer of a guest."""

    class Condition(threading.Condition):
        """A condition whose waits end at the unload."""

        def wait(self, timeout: Optional[float] = None) -> bool:
            return guest.wait_for(functools.partial(threading.Condition.wait, self), timeout)

    def with_condition(base: Type[Any]) -> Type[Any]:
        def init(self: Any, *args: Any, **kwds: Any) -> None:
            base.__init__(self, *args, **kwds)
            self._cond = Condition(self._cond._lock)

        return type(base.__name__, (base,), {"__init__": init, "__doc__": base.__doc__})

    waiting = ("Event", "Semaphore", "BoundedSemaphore", "Barrier")
    own: Dict[str, Any] = {each: with_condition(getattr(threading, each)) for each in waiting}
    own.update(Thread=Thread, Timer=Timer, Condition=Condition, main_thread=lambda: guest.main)
    return View(threading, own)


def _signal(guest: Guest) -> View:
    handlers: Dict[int, Any] = {}

    def set_handler(number: int, handler: Any) -> Any:
        before = handlers.get(number, signal.SIG_DFL)
        handlers[number] = handler
        return before

    def tell(reason: str) -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            handler = handlers.pop(number, None)
            if callable(handler):
                with contextlib.suppress(SystemExit):
                    handler(number, None)

    def pause() -> None:
        guest.waits()
        guest.closing.wait()

    guest.hooks_after.append(tell)
    get_handler = functools.partial(_get, handlers)
    return _partly_refused(guest, "signal", signal=set_handler, getsignal=get_handler, pause=pause)


def _get(handlers: Dict[int, Any], number: int) -> Any:
    return handlers.get(number, signal.SIG_DFL)


def _kill(guest: Guest) -> Callable[[int, int], None]:
    def kill(pid: int, number: int) -> None:
        if pid == os.getpid() and number:
            guest.unload()
        else:
            os.kill(pid, number)

    return kill


def _refusing(guest: Guest) -> Views:
    """Views of what a guest that shares its process must not use, or not all of it."""

    def refuse(toolkit: str) -> Callable[[], Module]:
        return lambda: _refusal(guest, f"the toolkit {toolkit}")()

    views: Views = {name: functools.partial(_partly_refused, guest, name) for name in _REFUSED}
    return {**views, **{name: refuse(name) for name in _TOOLKITS}}


def _partly_refused(guest: Guest, name: str, **own: Any) -> View:
    real = importlib.import_module(name)
    refused = {
        call: _refusal(guest, f"{name}.{call}") for call in _REFUSED[name] if hasattr(real, call)
    }
    return View(real, {**refused, **own})


def _refusal(guest: Guest, what: str) -> Callable[..., NoReturn]:
    def refused(*args: Any, **kwds: Any) -> NoReturn:
        raise NeedsProcess(guest.name, what)

    return refused


class _NoKeyboard:
    """The standard input of a guest that shares its process."""

    def __init__(self, guest: Guest) -> None:
        self._guest = guest

    def isatty(self) -> bool:
        return False

    def __getattr__(self, name: str) -> Any:
        raise NeedsProcess(self._guest.name, "the keyboard (sys.stdin)")
