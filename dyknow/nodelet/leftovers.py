# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What remains of nodelets after their unload: code that still runs, and memory.

An unload waits for no callback, so code of a nodelet may run on after it. And a nodelet may be
part of a reference cycle. As long as either is so, the nodelet is kept in a list here, without
a reference to it, and examined now and then.
"""

from __future__ import annotations

import threading
import weakref
from dataclasses import dataclass
from typing import Any, Callable, List, Tuple

from dyknow.locks import state_lock
from dyknow.nodelet.context import Context
from dyknow.nodelet.cycles import break_cycles
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.nodelet.memory import return_free_memory
from dyknow.nodelet.pubsub import Publisher, Subscriber
from dyknow.nodelet.service import Service
from dyknow.nodelet.timers import Timer
from dyknow.periodic import attempt, in_background

#: Seconds between two looks, and at least between two returns of memory to the system.
_PERIOD = 0.5
#: Looks after the last code has ended, until a nodelet that is not free is left to Python.
_LOOKS = 4
#: What belongs to the runtime, and does not refer to a nodelet any more.
_OURS = (Context, PlainNodeHandle, Publisher, Subscriber, Service, Timer)


@dataclass
class _Leftover:
    name: str
    reference: weakref.ReferenceType[Any]
    age: Callable[[], float]
    hooks: List[Callable[[], None]]
    looks: int = _LOOKS

    def is_gone(self) -> bool:
        """Look; whether there is nothing left, or nothing that can be done."""
        if self.age() > 0.0:
            return False
        while self.hooks:
            attempt("freeing a nodelet", self.hooks.pop())
        self.looks -= 1
        return break_cycles(self.reference, _OURS) or self.looks <= 0


class Leftovers:
    """The nodelets of one loader that were unloaded and are not gone yet."""

    def __init__(self, give_back: Callable[[], object] = return_free_memory) -> None:
        """Begin without any.

        Args:
            give_back: returns free memory to the system, after unloads.
        """
        self._lock = state_lock("leftovers")
        self._left: List[_Leftover] = []
        self._give_back = give_back
        self._closed = threading.Event()
        self._is_looking = False

    def add(
        self,
        name: str,
        nodelet: weakref.ReferenceType[Any],
        age: Callable[[], float],
        hooks: List[Callable[[], None]],
    ) -> None:
        """Free a nodelet that was unloaded, now or as soon as none of its code runs.

        Args:
            name: the name that it had.
            nodelet: to which the runtime does not refer any more.
            age: returns for how many seconds code of it has been running; 0.0 if none runs.
            hooks: called then.
        """
        left = _Leftover(name, nodelet, age, hooks)
        is_gone = left.is_gone()
        with self._lock:
            if not is_gone:
                self._left.append(left)
            starts, self._is_looking = not self._is_looking, True
        if starts:
            in_background("freeing nodelets", self._look)

    def running(self) -> List[Tuple[str, float]]:
        """List the nodelets whose code still runs, with the seconds since it began."""
        with self._lock:
            left = list(self._left)
        ages = sorted((each.name, each.age()) for each in left)
        return [(name, age) for name, age in ages if age > 0.0]

    def close(self) -> None:
        """Look no more."""
        self._closed.set()

    def _look(self) -> None:
        """Look until nothing is left, and return memory after each look."""
        while not self._closed.wait(_PERIOD):
            gone = [each for each in list(self._left) if each.is_gone()]
            with self._lock:
                self._left = [each for each in self._left if each not in gone]
                self._is_looking = bool(self._left)
                is_over = not self._left
            self._give_back()
            if is_over:
                return
