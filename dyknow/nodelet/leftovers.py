# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What remains of nodelets after their unload: code that still runs, and memory.

An unload waits for no callback, so code of a nodelet may run on after it. And a nodelet may be
part of a reference cycle. As long as either is so, the nodelet is kept in a list here, without
a reference to it, and examined now and then.
"""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from typing import Any, Callable, List

from dyknow.locks import state_lock
from dyknow.nodelet.context import Context
from dyknow.nodelet.cycles import break_cycles
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.nodelet.memory import return_free_memory
from dyknow.nodelet.pubsub import Publisher, Subscriber
from dyknow.nodelet.service import Service
from dyknow.nodelet.timers import Timer
from dyknow.periodic import PeriodicWorker

#: Seconds between two looks, and at least between two returns of memory to the system.
_PERIOD = 0.5
#: Looks after the last code has ended, until a nodelet that is not free is left to Python.
_LOOKS = 4
#: What belongs to the runtime, and does not refer to a nodelet any more.
_OURS = (Context, PlainNodeHandle, Publisher, Subscriber, Service, Timer)


@dataclass
class _Leftover:
    reference: weakref.ReferenceType[Any]
    is_busy: Callable[[], bool]
    hooks: List[Callable[[], None]]
    looks: int = _LOOKS

    def is_gone(self) -> bool:
        """Look; whether there is nothing left, or nothing that can be done."""
        if self.is_busy():
            return False
        while self.hooks:
            self.hooks.pop()()
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
        self._worker = PeriodicWorker(
            "freeing nodelets", self._look, lambda: _PERIOD if self._left else None, _PERIOD
        )

    def add(
        self,
        nodelet: weakref.ReferenceType[Any],
        is_busy: Callable[[], bool],
        hooks: List[Callable[[], None]],
    ) -> None:
        """Free a nodelet that was unloaded, now or as soon as none of its code runs.

        Args:
            nodelet: to which the runtime does not refer any more.
            is_busy: whether code of it still runs.
            hooks: called then.
        """
        left = _Leftover(nodelet, is_busy, hooks)
        if not left.is_gone():
            with self._lock:
                self._left.append(left)
        self._worker.start()
        self._worker.wake()

    def close(self) -> None:
        """Look no more."""
        self._worker.close()

    def _look(self) -> None:
        gone = [each for each in list(self._left) if each.is_gone()]
        with self._lock:
            self._left = [each for each in self._left if each not in gone]
        self._give_back()
