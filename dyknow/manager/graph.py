# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The manager's picture of the running nodelets, with one operation at a time on each.

Ownership: the graph owns the records, the revision and the lifetimes. Every record that has to
survive the manager is written to the store before it is shown. A name is *busy* while one
operation works on its nodelet; other operations pass the time that they will wait for it.
"""

from __future__ import annotations

import contextlib
import sys
from dataclasses import dataclass
from typing import Callable, Iterable, Iterator, Mapping

from dyknow.errors import Busy, LimitExceeded, NameTaken
from dyknow.locks import state_condition, turn_lock
from dyknow.manager.record import Record, Records
from dyknow.manager.store import Store
from dyknow.model.graph import State
from dyknow.periodic import STEADY, Clock

#: Seconds to wait for a look, or another operation, to be done with a nodelet.
PATIENCE = 5.0
#: Seconds to wait for a nodelet that is being made: its nodelet manager may have to start first.
_BEING_MADE = 30.0
#: Revisions that are reserved on disk at a time, so that not every change has to be written.
_BLOCK = 1000


@dataclass(frozen=True)
class _Life:
    """When a nodelet came up, and when it was lost; None while it runs."""

    begin: float
    end: float | None = None


class Graph:
    """Records by name, with a revision that never goes back; safe from any thread."""

    def __init__(
        self, store: Store, clock: Clock = STEADY, on_change: Callable[[], object] = lambda: None
    ) -> None:
        """Start empty, with a revision beyond every one that was ever shown."""
        self._store = store
        self._clock = clock
        self._turn = turn_lock("nodelets on disk")
        self._changed = state_condition("records of nodelets")
        #: All records by name, sorted; replaced as a whole by every change.
        self.records = Records()
        self._lives: dict[str, _Life] = {}
        self._busy: set[str] = set()
        #: Nodelets that are being restarted: claims wait for them.
        self.restarting: frozenset[str] = frozenset()
        self.revision = store.number("revision")
        if store.complaint:  # a backup took the place of a file that may have reserved more
            self.revision += _BLOCK
        self._reserved = self.revision
        #: Called after every change of nodelets or transformations, outside the locks.
        self.on_change = on_change
        with self._turn:
            self._reserve()
        self.revision += 1

    def all(self) -> list[Record]:
        return list(self.records.values())

    def get(self, name: str) -> Record:
        return self.records[name]

    def find(self, name: str) -> Record | None:
        return self.records.get(name)

    def lifetime(self, name: str) -> float:
        """Seconds of a nodelet's present life or, if it does not run, of its last one."""
        with self._changed:
            life = self._lives.get(name)
            if life is None:
                return 0.0
            return (self._clock.now() if life.end is None else life.end) - life.begin

    def is_busy(self, name: str) -> bool:
        return name in self._busy

    @contextlib.contextmanager
    def changing(
        self, name: str, new: bool = False, patience: float = 0.0, most: int = sys.maxsize
    ) -> Iterator[Record | None]:
        """Reserve a name for one operation; yields its record, or None.

        It waits for another operation on it for so many seconds. There may be ``most`` nodelets of
        ours with it, and with those that are being made.

        Raises:
        Busy: another operation works on it.
        NameTaken: it has to be ``new``, and is taken.
        LimitExceeded: there are too many.
        """
        with self._changed:
            deadline = self._clock.now() + patience
            while name in self._busy:
                left = deadline - self._clock.now()
                if left <= 0.0:
                    raise NameTaken(name) if new else Busy(name)
                self._clock.wait(self._changed, left)
            if new:
                self._check_new(name, most)
            self._busy.add(name)
            record = self.records.get(name)
        try:
            yield record
        finally:
            with self._changed:
                self._busy.discard(name)
                self._changed.notify_all()

    @contextlib.contextmanager
    def changing_present(self, name: str) -> Iterator[Record]:
        """Reserve a nodelet that is there, once it is if it is being made; yields its record.

        Raises UnknownNodelet, or Busy if another operation works on it for long.
        """
        patience = PATIENCE if name in self.records else _BEING_MADE
        with self.changing(name, patience=patience):
            yield self.get(name)

    def _check_new(self, name: str, most: int) -> None:
        if name in self.records:
            raise NameTaken(name)
        ours = len([each for each in self.records.values() if not each.owner])
        count = ours + len(self._busy - self.records.keys()) + 1
        if count > most:
            raise LimitExceeded("nodelets", count, most)

    @contextlib.contextmanager
    def changing_all(self, names: Iterable[str]) -> Iterator[list[Record]]:
        """Reserve nodelets for one operation; yields the records of those that are there.

        Raises Busy if another operation works on one of them for long.
        """
        with contextlib.ExitStack() as held:
            found = [
                held.enter_context(self.changing(name, patience=PATIENCE))
                for name in sorted(names)
            ]
            yield [record for record in found if record is not None]

    @contextlib.contextmanager
    def restart(self, names: Iterable[str]) -> Iterator[list[Record]]:
        """Reserve nodelets for a restart; yields the records of those that are there."""
        with self.changing_all(names) as records:
            marked = frozenset(record.name for record in records)
            with self._changed:
                self.restarting |= marked
            try:
                yield records
            finally:
                with self._changed:
                    self.restarting -= marked

    def put(self, *records: Record, soon: bool = False) -> None:
        """Show records, all in one step; those that are stored are written first.

        With ``soon`` they are written with the next change, or by the next look.
        """
        with self._turn:
            new = {each.name: each for each in records if self.records.get(each.name) != each}
            if not new:
                return
            bodies = {
                ("nodelets", name): each.body() if each.is_stored else None
                for name, each in new.items()
            }
            (self._store.write_later if soon else self._store.write)(bodies)
            self._reserve()
            with self._changed:
                for record in new.values():
                    self._note_life(record)
                self._show({**self.records, **new})
        self.on_change()

    def remove(self, name: str) -> None:
        """Forget a record, on disk first."""
        with self._turn:
            self._store.write({("nodelets", name): None})
            if self.find(name) is None:
                return
            self._reserve()
            with self._changed:
                self._lives.pop(name, None)
                self._show({key: each for key, each in self.records.items() if key != name})
        self.on_change()

    def _reserve(self) -> None:
        """Write to the disk that the next revision may be shown; in the turn of the disk."""
        if self.revision == self._reserved:
            self._reserved += _BLOCK
            self._store.write({("facts", "revision"): str(self._reserved)})

    def _show(self, records: Mapping[str, Record]) -> None:
        self.records = Records(sorted(records.items()))
        self.revision += 1

    def _note_life(self, record: Record) -> None:
        before, life = self.records.get(record.name), self._lives.get(record.name)
        now = self._clock.now()
        if record.state is not State.RUNNING:
            if life is not None and life.end is None:
                self._lives[record.name] = _Life(life.begin, now)
        elif (
            life is None
            or life.end is not None
            or before is None
            or before.incarnation != record.incarnation
        ):
            self._lives[record.name] = _Life(now)
