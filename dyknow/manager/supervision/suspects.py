# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that crash their processes, and are isolated for that.

A nodelet that crashes its process takes its neighbours along each time that it comes back. The
nodelets whose code ran when a process crashed are accused. After two accusations a nodelet is
restored in a process of its own, where it harms no other.

A nodelet of a claim does not come back: another nodelet, perhaps of another name, is made of its
transformation. So the transformation is accused instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Iterable, Union

from dyknow import names
from dyknow.locks import state_lock
from dyknow.manager.host import Crash
from dyknow.manager.record import Record

#: Accusations after which a nodelet gets a process of its own: one may be chance.
ENOUGH = 2
#: Seconds after which an accusation that led to nothing is forgotten.
MEMORY = 600.0

_Accused = Union[int, str]
"""The mark of a nodelet, or the label of the transformation of those of claims."""


@dataclass(frozen=True)
class _Account:
    accusations: int
    last: float
    cause: str


class Suspects:
    """Accusations by nodelet or transformation; safe from any thread."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """Start without accusations, with a steady clock in seconds."""
        self._clock = clock
        self._state_lock = state_lock("suspects")
        self._accounts: dict[_Accused, _Account] = {}
        #: Transformations of the nodelets of claims, those that are gone included, since crashes
        #: are reported late; names are used again, so there are not many.
        self._labels: dict[int, str] = {}

    def know(self, record: Record) -> None:
        """Take note of a nodelet, before its code runs."""
        mark = names.mark(record.name)
        with self._state_lock:
            if record.claimed:
                self._labels[mark] = record.label
            else:
                self._labels.pop(mark, None)

    def accuse(self, crash: Crash, hosted: Iterable[str]) -> set[str]:
        """Accuse the nodelets whose code ran or, if unknown, those that the process ``hosted``.

        Returns the transformations of accused nodelets of claims that it hosts no more.
        """
        here = frozenset(names.mark(name) for name in hosted)
        marks = here if crash.running is None else crash.running
        now = self._clock()
        with self._state_lock:
            recent = {k: each for k, each in self._accounts.items() if now - each.last <= MEMORY}
            for mark in {self._accused(mark) for mark in marks}:
                count = recent[mark].accusations if mark in recent else 0
                recent[mark] = _Account(count + 1, now, crash.cause)
            self._accounts = recent
            return {self._labels[mark] for mark in marks - here if mark in self._labels}

    def verdict(self, name: str) -> str:
        """Return why a nodelet needs a process of its own; empty if it needs none."""
        with self._state_lock:
            account = self._accounts.get(self._accused(names.mark(name)))
        if account is None or account.accusations < ENOUGH:
            return ""
        if self._clock() - account.last > MEMORY:
            return ""
        return (
            f"alone in its process: {account.accusations} crashes while its code ran, "
            f"the last by {account.cause}"
        )

    def acquit(self, name: str) -> None:
        """Forget the accusations of a nodelet: its code may have been mended."""
        with self._state_lock:
            self._accounts.pop(self._accused(names.mark(name)), None)

    def acquit_transformation(self, label: str) -> None:
        """Forget the accusations of a transformation, which was replaced."""
        with self._state_lock:
            self._accounts.pop(label, None)

    def _accused(self, mark: int) -> _Accused:
        return self._labels.get(mark) or mark
