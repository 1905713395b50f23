# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The remains of nodelets after their unload, and callbacks that do not return.

An unload waits for no callback, so code of a nodelet may run on after it. And a nodelet may be
part of a reference cycle. As long as either is so, the nodelet is kept in a list here, without
a reference to it, and examined now and then.

A nodelet with a callback that does not return answers its services and is listed as before, and
the callback of a nodelet that was unloaded goes on: Python cannot end a thread. Both are
announced.
"""

from __future__ import annotations

import logging
import threading
import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Callable

from dyknow.locks import state_lock
from dyknow.model.graph import STUCK
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import PlainNodeHandle, Service
from dyknow.nodelet.loading.memory import break_cycles, return_free_memory
from dyknow.nodelet.streams.pubsub import Publisher, Subscriber
from dyknow.nodelet.timers import Timer
from dyknow.periodic import NO_THREAD, PeriodicWorker, attempt, in_background

if TYPE_CHECKING:
    from dyknow.nodelet.loading.loader import Loader

#: Seconds between two examinations, and at least between two returns of memory to the system.
_PERIOD = 0.5
#: Examinations after the last code has ended, until a nodelet that is not free is left to Python.
_ATTEMPTS = 4
#: Objects of the runtime, which do not refer to a nodelet any more.
_OURS = (Context, PlainNodeHandle, Publisher, Subscriber, Service, Timer)
#: Rounds in the time after which a callback is reported, and the longest pause between two.
_ROUNDS = 4
_LONGEST_PAUSE = 2.5

_log = logging.getLogger("rosout.dyknow")


@dataclass
class _Leftover:
    name: str
    reference: weakref.ReferenceType[Any]
    age: Callable[[], float]
    hooks: list[Callable[[], None]]
    attempts: int = _ATTEMPTS

    def is_gone(self) -> bool:
        """Return whether nothing is left, or nothing that can be freed."""
        if self.age() > 0.0:
            return False
        while self.hooks:
            attempt("freeing a nodelet", self.hooks.pop())
        self.attempts -= 1
        return break_cycles(self.reference, _OURS) or self.attempts <= 0


class Leftovers:
    """The nodelets of one loader that were unloaded and are not gone yet."""

    def __init__(self) -> None:
        self._lock = state_lock("leftovers")
        self._left: list[_Leftover] = []
        self._closed = threading.Event()
        self._is_examining = False

    def add(
        self,
        name: str,
        nodelet: weakref.ReferenceType[Any],
        age: Callable[[], float],
        hooks: list[Callable[[], None]],
    ) -> None:
        """Free an unloaded nodelet once none of its code runs, and call ``hooks`` then."""
        left = _Leftover(name, nodelet, age, hooks)
        remaining = [] if left.is_gone() else [left]
        with self._lock:
            self._left += remaining
            starts, self._is_examining = not self._is_examining, True
        if starts:
            try:
                in_background("freeing nodelets", self._examine)
            except NO_THREAD as error:
                self._is_examining = False
                _log.warning("%s is freed after the next unload: %s", name, error)

    def running(self) -> dict[str, float]:
        """Nodelets whose code still runs, sorted by name, with the seconds since it began."""
        with self._lock:
            left = list(self._left)
        ages = sorted((each.name, each.age()) for each in left)
        return {name: age for name, age in ages if age > 0.0}

    def close(self) -> None:
        self._closed.set()

    def _examine(self) -> None:
        """Examine until nothing is left, and return memory each time."""
        while not self._closed.wait(_PERIOD):
            gone = [each for each in list(self._left) if each.is_gone()]
            with self._lock:
                self._left = [each for each in self._left if each not in gone]
                is_over = not self._left
                self._is_examining = not is_over
            return_free_memory()
            if is_over:
                return


class StuckCallbacks:
    """Announces the nodelets of a process with callbacks that do not return, and the remains.

    Callbacks that have not begun, since the system refused a thread, are started when it can be.
    """

    def __init__(
        self, loader: Loader, host: str, after: float, announce: Callable[[str], None]
    ) -> None:
        """Prepare; callbacks are reported ``after`` so many seconds.

        ``host`` is the node of this process, for advice; ``announce`` gets the name of each
        nodelet whose ``detail`` has changed.
        """
        self._loader = loader
        self._host = host
        self._announce = announce
        self._after = after
        self._due: dict[str, float] = {}  # age at which a nodelet is announced again
        self._remains_due: dict[str, float] = {}
        what = "looking for callbacks that do not return"
        period = min(after / _ROUNDS, _LONGEST_PAUSE)
        self._worker = PeriodicWorker(what, self.check, period)
        self.start = self._worker.start
        self.close = self._worker.close

    def check(self) -> None:
        """Announce changes, and a callback that still runs each time that its age has doubled."""
        self._loader.runtime.catch_up()
        ages = {each.name: each.callback_age() for each in self._loader.contexts()}
        before = set(self._due)
        stuck = _due_now(self._due, ages, self._after)
        for name in sorted({*stuck, *(before - set(self._due)) & set(ages)}):
            self._announce(name)
        running = self._loader.leftovers.running()
        for name in _due_now(self._remains_due, running, self._after):
            _log.warning(
                "%s; it ends with its process alone: rosnode kill %s, which a DyKnow manager "
                "starts again with the other nodelets; spawn such a nodelet isolated",
                _remains_text(name, running[name]),
                self._host,
            )

    def detail(self, nodelet: str) -> str:
        """Describe a nodelet's callback that does not return; empty if it has none."""
        context = self._loader.find(nodelet)
        age = context.callback_age() if context is not None else 0.0
        return f"{STUCK}{age:.0f} s" if age >= self._after else ""

    def remains(self) -> list[str]:
        """Describe the code of unloaded nodelets that still runs, a line for each."""
        return [_remains_text(*each) for each in self._loader.leftovers.running().items()]


def _remains_text(name: str, age: float) -> str:
    return f"{name} was unloaded, but code of it has been running for {age:.0f} s"


def _due_now(due: dict[str, float], ages: dict[str, float], after: float) -> list[str]:
    """Return the names that are to be announced, and note when each is again."""
    for name in [name for name in due if ages.get(name, 0.0) < after]:
        del due[name]
    now = [name for name, age in sorted(ages.items()) if age >= due.get(name, after)]
    due.update({name: 2.0 * ages[name] for name in now})
    return now
