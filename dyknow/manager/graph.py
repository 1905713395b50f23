"""The manager's picture of what runs, and who is changing which part of it.

Who owns what: the graph owns the records and the revision; every record that is to survive the
manager is written to the store before anybody sees it. A name is *busy* while one operation works
on its nodelet; others say how long they are willing to wait for it.
"""

from __future__ import annotations

import contextlib
import threading
from typing import Callable, Dict, Iterator, List, Optional, Set

from dyknow.errors import Busy, NameTaken, UnknownNodelet
from dyknow.manager.record import Record
from dyknow.manager.store import Store

#: Revisions that are reserved on disk at a time, so that not every change has to be written.
_BLOCK = 1000


class Graph:
    """Records by name, with a revision that never goes back."""

    def __init__(self, store: Store) -> None:
        """Start empty; the revision goes on beyond every one that was ever shown."""
        self._store = store
        self._lock = threading.Condition()
        self._records: Dict[str, Record] = {}
        self._busy: Set[str] = set()
        self._revision = store.number("revision")
        self._reserved = self._revision
        #: Called after every change, outside the lock.
        self.on_change: Callable[[], None] = lambda: None
        self._count()

    @property
    def revision(self) -> int:
        """Grows with every change."""
        return self._revision

    def all(self) -> List[Record]:
        """Return every record, by name."""
        with self._lock:
            return [self._records[name] for name in sorted(self._records)]

    def get(self, name: str) -> Record:
        """Return the record of that name.

        Raises:
            UnknownNodelet: there is none.
        """
        with self._lock:
            found = self._records.get(name)
            if found is None:
                raise UnknownNodelet(name, self._records)
            return found

    def find(self, name: str) -> Optional[Record]:
        """Return the record of that name, or None."""
        with self._lock:
            return self._records.get(name)

    def is_busy(self, name: str) -> bool:
        """Whether an operation works on it now."""
        return name in self._busy

    @contextlib.contextmanager
    def changing(
        self, name: str, new: bool = False, patience: float = 0.0
    ) -> Iterator[Optional[Record]]:
        """Keep others off a name; gives its record.

        Args:
            name: of the nodelet.
            new: it must not be there yet.
            patience: seconds to wait for another operation to end, such as a look.

        Raises:
            Busy: another operation works on it.
            NameTaken: it is to be ``new`` and is there.
        """
        with self._lock:
            if not self._lock.wait_for(lambda: name not in self._busy, patience):
                raise NameTaken(name) if new else Busy(name)
            if new and name in self._records:
                raise NameTaken(name)
            self._busy.add(name)
            record = self._records.get(name)
        try:
            yield record
        finally:
            with self._lock:
                self._busy.discard(name)
                self._lock.notify_all()

    def put(self, *records: Record, durable: bool = True) -> None:
        """Show records, all in one step, after they were written if they are to be durable."""
        with self._lock:
            new = [each for each in records if self._records.get(each.name) != each]
        if not new:
            return
        if durable:
            for record in new:
                self._store.put_nodelet(record)
        with self._lock:
            self._records.update((record.name, record) for record in new)
            self._count()
        self.on_change()

    def remove(self, name: str) -> None:
        """Forget a record, on disk first."""
        self._store.remove_nodelet(name)
        with self._lock:
            if self._records.pop(name, None) is None:
                return
            self._count()
        self.on_change()

    def _count(self) -> None:
        self._revision += 1
        if self._revision > self._reserved:
            self._reserved = self._revision + _BLOCK
            self._store.set_number("revision", self._reserved)
