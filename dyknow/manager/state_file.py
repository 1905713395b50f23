"""A file of texts by table and key, and every fault of file and disk.

One sqlite file. What is written is on disk, for every other process, before the call returns. Two
kinds of fault are told apart:

- *Trouble*: the file cannot be read or written now (disk full, read-only, locked by another
  program). The file is left alone: its rows are read from a private copy if need be, changes are
  kept in memory, and both go to the file as soon as it can be written.
- *Damage*: what is in the file is not what was written. Rows that can be read go to a new file,
  the old one is set aside.

A file is damaged if a private copy of it is: with a copy nobody else interferes, and there is room
for it.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import shutil
import sqlite3
import tempfile
import time
from pathlib import Path
from typing import Callable, Dict, Iterator, Mapping, Optional, Tuple

from dyknow.errors import StoreError
from dyknow.locks import turn_lock

IN_MEMORY = ":memory:"
#: Changes with the tables.
FORMAT = 1
#: Seconds to wait for another program's lock: at the start, and for each change.
_START_PATIENCE = 5.0
_PATIENCE = 1.0
#: Seconds between two attempts to write what the disk did not take.
_RETRY = 1.0
#: Seconds after which a trouble that goes on is reported again.
_REMINDER = 60.0

#: The columns of each table that hold keys and texts.
_TABLES = {
    "facts": ("name", "value"),
    "transformations": ("label", "body"),
    "nodelets": ("name", "body"),
    "claims": ("id", "body"),
}

_READ_ONLY = "readonly"
#: What sqlite says of a file that cannot be worked with now, and what that means to a user.
_TROUBLES = {
    "disk is full": "the disk is full; free some space",
    "lock": "it is locked by another program, such as a backup or an sqlite3 shell; "
    "let that finish, or end it",
    _READ_ONLY: "it is read-only; look at the permissions of the file and its folder and at how "
    "the disk is mounted, or choose another folder (~state_dir)",
    "unable to open": "it cannot be opened; look at the permissions of its folder and whether the "
    "disk is full, or choose another folder (~state_dir)",
    "disk I/O error": "the disk does not take it (input/output error); look for a quota, a size "
    "limit or a failing disk",
}

#: Bytes of a page, as sqlite makes files, and where the first one has a count that says whether
#: the number of pages beside it is to be trusted.
_PAGE = 4096
_COUNTS_CHANGES = 95

#: Texts by key; None for a row that is to go.
Changes = Mapping[Tuple[str, str], Optional[str]]
_Rows = Dict[str, Dict[str, str]]

_log = logging.getLogger("rosout.dyknow")


class _Damaged(Exception):
    """What is in the file is not what was written."""


class StateFile:
    """Texts by table and key; every method is safe from any thread."""

    def __init__(self, path: str, clock: Callable[[], float] = time.monotonic) -> None:
        """Open the file, or begin an empty one.

        Args:
            path: the file; ``IN_MEMORY`` for none.
            clock: seconds, steady.

        Raises:
            StoreError: the folder cannot be made, or the file is there and cannot be read at all.
        """
        self.path = path
        #: Why what changed last is not on disk yet, and what to do; empty if it is.
        self.trouble = ""
        #: What was damaged and where it was put; empty if nothing was.
        self.complaint = ""
        self._clock = clock
        self._turn = turn_lock("state file")
        self._connection: Optional[sqlite3.Connection] = None
        self._rows: Optional[_Rows] = None  # of a file that is not open
        self._damage = ""  # why that file must not be used any more
        self._pending: Dict[Tuple[str, str], Optional[str]] = {}
        self._retry_at = self._remind_at = float("-inf")
        with self._turn:
            self._start()

    def rows(self, table: str) -> Dict[str, str]:
        """Read a table, by key.

        Raises:
            StoreError: it cannot be read.
        """
        with self._turn:
            rows = self._stored(table)
            for (changed, key), text in self._pending.items():
                if changed == table:
                    rows.pop(key, None)
                    if text is not None:
                        rows[key] = text
        return dict(sorted(rows.items()))

    def get(self, table: str, key: str) -> Optional[str]:
        """Read one row; None if it is not there."""
        return self.rows(table).get(key)

    def write(self, changes: Changes) -> None:
        """Write rows, all or none: to the disk or, as long as it does not take them, to memory.

        Raises:
            StoreError: the file is closed.
        """
        with self._turn:
            if self.trouble and self._clock() < self._retry_at:
                self._pending.update(changes)
            else:
                self._write({**self._pending, **changes})

    def write_pending(self) -> None:
        """Write what the disk did not take, if there is any and it is time to try again."""
        with self._turn:
            if self.trouble and self._clock() >= self._retry_at:
                self._write(self._pending)

    def reject(self, table: str, causes: Mapping[str, str]) -> None:
        """Take rows that mean nothing out of the file, and put them beside it, with the causes."""
        with self._turn:
            known = self._stored(table)
            rejected = [
                {"table": table, "key": key, "text": known.get(key), "cause": causes[key]}
                for key in sorted(causes)
            ]
            aside = self._aside(".json")
            what = "; ".join(f"{table} '{key}': {causes[key]}" for key in sorted(causes))
            try:
                with open(aside, "w") as file:
                    json.dump(rejected, file, indent=1)
            except OSError as error:  # they stay where they are until there is room for them
                self._complain(f"entries cannot be used, nor set aside ({error}): {what}")
                return
            self._complain(f"entries cannot be used and were set aside as '{aside}': {what}")
            self._write({**self._pending, **{(table, key): None for key in causes}})

    def close(self) -> None:
        """Close the file; what the disk has not taken is lost."""
        with self._turn:
            if self.trouble:
                with contextlib.suppress(StoreError):
                    self._write(self._pending)
            if self._pending:
                _log.error("%s. %d changes are lost", self.trouble, len(self._pending))
            if self._connection is not None:
                self._connection.close()

    # Opening

    def _start(self) -> None:
        if self.path != IN_MEMORY:
            try:
                os.makedirs(os.path.dirname(os.path.abspath(self.path)), exist_ok=True)
                self._finish_replacement()
                if os.path.exists(self.path) and os.path.getsize(self.path) == 0:
                    self._complain("is empty: nothing can be restored from it")
            except OSError as error:
                raise StoreError(self.path, error) from error
        try:
            self._connection = _connect(self.path, _START_PATIENCE)
        except (sqlite3.Error, _Damaged) as error:
            self._rows, self._damage = self._rescue()
            if not self._damage:
                self._note_trouble(error)
                return
            self._write({})

    def _rescue(self) -> Tuple[_Rows, str]:
        """Read a file that could not be opened; returns its rows and what is damaged.

        No connection of this process may have the file open: reading it gives up its locks.
        """
        try:
            with tempfile.TemporaryDirectory(prefix="dyknow-", dir=_scratch()) as folder:
                copy = os.path.join(folder, "state")
                for suffix in ("", "-wal"):
                    if os.path.exists(self.path + suffix):
                        shutil.copyfile(self.path + suffix, copy + suffix)
                return _read_copy(copy)
        except (OSError, sqlite3.OperationalError) as error:
            try:
                return _read_in_place(self.path), ""
            except (sqlite3.Error, _Damaged):
                raise StoreError(self.path, f"it cannot be read: {error}") from error

    def _reopen(self) -> None:
        """Open a file that could not be opened, or was damaged, when it was tried last.

        Raises:
            sqlite3.Error, OSError: it still does not work.
        """
        if self._rows is None:
            self._rows, self._damage = self._rescue()
        if not self._damage:
            try:
                self._connection = _connect(self.path, 0.0)
            except (sqlite3.Error, _Damaged) as error:
                if _trouble(error):
                    raise
                self._damage = str(error)
        if self._damage:
            self._replace(self._rows)
        self._rows, self._damage = None, ""

    def _replace(self, rows: _Rows) -> None:
        """Begin a new file with these rows; the old one is set aside once the new is complete."""
        new = self.path + ".new"
        for suffix in ("", "-wal", "-shm"):
            with contextlib.suppress(FileNotFoundError):
                os.remove(new + suffix)
        with contextlib.closing(_connect(new, 0.0)) as connection:
            _put(
                connection,
                {(table, key): text for table in rows for key, text in rows[table].items()},
            )
        aside = self._aside()
        for suffix in ("-wal", "-shm", ""):
            if os.path.exists(self.path + suffix):
                os.replace(self.path + suffix, aside + suffix)
        os.replace(new, self.path)
        self._connection = _connect(self.path, 0.0)
        kept = ", ".join(f"{len(rows[table])} {table}" for table in _TABLES if rows[table])
        self._complain(
            f"could not be used ({self._damage}); it was set aside as '{aside}', and a new one "
            f"was begun with what could be read: {kept or 'nothing'}"
        )

    def _finish_replacement(self) -> None:
        """Complete what an earlier life was killed in: nothing but the new file is left."""
        if os.path.exists(self.path + ".new") and not os.path.exists(self.path):
            os.replace(self.path + ".new", self.path)

    def _aside(self, ending: str = "") -> str:
        """Name a file beside this one that is not there yet."""
        base = f"{self.path}.broken-{time.strftime('%Y%m%d-%H%M%S')}"
        name, count = base + ending, 1
        while os.path.exists(name):
            count += 1
            name = f"{base}-{count}{ending}"
        return name

    def _complain(self, what: str) -> None:
        # Bytes that are no UTF-8 can be in what is damaged, but not in a message of ROS.
        what = what.encode("utf-8", "backslashreplace").decode("utf-8")
        complaint = f"state file '{self.path}': {what}"
        self.complaint += ("\n" if self.complaint else "") + complaint
        _log.error("%s", complaint)

    # Reading and writing

    def _stored(self, table: str) -> Dict[str, str]:
        if self._rows is not None:
            return dict(self._rows[table])
        if self._connection is None:
            raise StoreError(self.path, self.trouble)
        try:
            return _rows_of(self._connection, table)
        except sqlite3.Error as error:
            raise StoreError(self.path, error) from error

    def _write(self, changes: Changes) -> None:
        try:
            if self._connection is None:
                self._reopen()
            self._put(changes)
        except (sqlite3.ProgrammingError, sqlite3.InterfaceError) as error:
            raise StoreError(self.path, error) from error
        except (sqlite3.Error, OSError, StoreError) as error:
            self._pending = dict(changes)
            self._note_trouble(error)
        else:
            self._pending = {}
            if self.trouble:
                self.trouble = ""
                self._remind_at = float("-inf")
                _log.warning("state file '%s' is written again; nothing is missing", self.path)

    def _put(self, changes: Changes) -> None:
        connection = self._connection
        assert connection is not None
        patience = 0.0 if self.trouble else _PATIENCE
        try:
            connection.execute(f"PRAGMA busy_timeout = {int(1000 * patience)}")
            _put(connection, changes)
        except (sqlite3.ProgrammingError, sqlite3.InterfaceError):
            raise
        except sqlite3.Error as error:
            if _trouble(error) or self.path == IN_MEMORY:
                raise
            connection.close()  # damaged while it was open
            self._connection = None
            self._reopen()
            assert self._connection is not None
            _put(self._connection, changes)

    def _meaning(self, error: Exception) -> str:
        """Say what is wrong, and what to do about it."""
        words = _trouble(error)
        if words == "unable to open" and not os.access(os.path.dirname(self.path) or ".", os.W_OK):
            words = _READ_ONLY
        return f"{_TROUBLES[words]} ({error})" if words else str(error)

    def _note_trouble(self, error: Exception) -> None:
        now = self._clock()
        self._retry_at = now + _RETRY
        damaged = (
            f"it is damaged ({self._damage}) and cannot be replaced: " if self._damage else ""
        )
        self.trouble = f"state file '{self.path}': {damaged}{self._meaning(error)}"
        if now >= self._remind_at:
            self._remind_at = now + _REMINDER
            _log.error(
                "%s. The manager goes on; until the file can be written, what changes is kept in "
                "memory, and lost if the manager is killed",
                self.trouble,
            )


def _scratch() -> Optional[str]:
    """Folder for a private copy: in memory, so that no disk has to have room for it."""
    memory = "/dev/shm"
    return memory if os.access(memory, os.W_OK) else None


def _trouble(error: BaseException) -> str:
    """Words of sqlite's that say why a file cannot be worked with now; empty for other errors."""
    if isinstance(error, sqlite3.OperationalError):
        for words in _TROUBLES:
            if words in str(error):
                return words
    return ""


def _connect(path: str, patience: float) -> sqlite3.Connection:
    """Open a file that is sound and can be written; makes the tables.

    Raises:
        sqlite3.Error, _Damaged: it is not.
    """
    connection = sqlite3.connect(
        path, timeout=patience, check_same_thread=False, isolation_level=None
    )
    try:
        # What is no UTF-8 is to be looked at by whoever reads the row.
        connection.text_factory = lambda raw: raw.decode("utf-8", "surrogateescape")
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
        if verdict != "ok":
            raise _Damaged(" ".join(verdict.split()))
        (found,) = connection.execute("PRAGMA user_version").fetchone()
        if found not in (0, FORMAT):
            raise _Damaged(f"it has format {found}, this program writes format {FORMAT}")
        for table, (key, text) in _TABLES.items():
            connection.execute(
                f"CREATE TABLE IF NOT EXISTS {table} "
                f"({key} TEXT PRIMARY KEY, {text} TEXT NOT NULL) WITHOUT ROWID"
            )
            (strange,) = connection.execute(
                f"SELECT count(*) FROM {table} "
                f"WHERE typeof({key}) <> 'text' OR typeof({text}) <> 'text'"
            ).fetchone()
            if strange:
                raise _Damaged(f"{strange} {table} are no text")
        connection.execute(f"PRAGMA user_version = {FORMAT}")
    except UnicodeDecodeError as error:  # in what sqlite says of a broken schema
        connection.close()
        raise _Damaged(f"its schema is broken: {error}") from error
    except BaseException:
        connection.close()
        raise
    return connection


def _rows_of(connection: sqlite3.Connection, table: str) -> Dict[str, str]:
    return dict(_cells(connection, table, "ASC"))


def _cells(connection: sqlite3.Connection, table: str, order: str) -> Iterator[Tuple[str, str]]:
    key, text = _TABLES[table]
    yield from connection.execute(f"SELECT {key}, {text} FROM {table} ORDER BY {key} {order}")


def _put(connection: sqlite3.Connection, changes: Changes) -> None:
    connection.execute("BEGIN IMMEDIATE")
    try:
        for table, (key, _) in _TABLES.items():
            mine = [(row, text) for (where, row), text in changes.items() if where == table]
            connection.executemany(
                f"REPLACE INTO {table} VALUES (?, ?)",
                [(row, text) for row, text in mine if text is not None],
            )
            # As bytes, since the key of a damaged row may be no text that sqlite would take.
            connection.executemany(
                f"DELETE FROM {table} WHERE {key} = CAST(? AS TEXT)",
                [(row.encode("utf-8", "surrogateescape"),) for row, text in mine if text is None],
            )
        connection.execute("COMMIT")
    except BaseException:
        # After some errors, a full disk among them, sqlite has rolled back by itself.
        if connection.in_transaction:
            with contextlib.suppress(sqlite3.Error):
                connection.execute("ROLLBACK")
        raise


def _read_copy(copy: str) -> Tuple[_Rows, str]:
    """Read a copy of a file; returns its rows and what is damaged.

    Raises:
        sqlite3.OperationalError: there is no room to read it.
    """
    try:
        with contextlib.closing(_connect(copy, 0.0)) as connection:
            return {table: _rows_of(connection, table) for table in _TABLES}, ""
    except (sqlite3.Error, _Damaged) as error:
        if isinstance(error, sqlite3.OperationalError) and "disk is full" in str(error):
            raise
        damage = str(error)
    rows = _salvaged(copy)
    if not any(rows.values()):
        _renew_first_page(copy)
        rows = _salvaged(copy)
    return rows, damage


def _salvaged(copy: str) -> _Rows:
    """Read what can be read of a damaged file."""
    rows: _Rows = {table: {} for table in _TABLES}
    with contextlib.closing(sqlite3.connect(copy, isolation_level=None)) as connection:
        connection.text_factory = lambda raw: raw.decode("utf-8", "surrogateescape")
        for table in _TABLES:
            for order in ("ASC", "DESC"):  # from both ends to where it is damaged
                with contextlib.suppress(sqlite3.Error, UnicodeDecodeError):
                    for key, text in _cells(connection, table, order):
                        if _is_text(key) and _is_text(text):
                            rows[table][key] = text
    return rows


def _renew_first_page(copy: str) -> None:
    """Replace the page without which no other can be read: all our files begin alike."""
    with contextlib.closing(_connect(copy + ".fresh", 0.0)):
        pass
    with open(copy + ".fresh", "rb") as fresh, open(copy, "r+b") as file:
        page = bytearray(fresh.read(_PAGE))
        page[_COUNTS_CHANGES] ^= 0xFF  # no longer the valid one, so the file's own size counts
        file.write(page)


def _read_in_place(path: str) -> _Rows:
    """Read a sound file where no copy can be made of it.

    Raises:
        sqlite3.Error, _Damaged: it cannot be read so.
    """
    has_log = os.path.exists(path + "-wal") and os.path.getsize(path + "-wal") > 0
    uri = Path(os.path.abspath(path)).as_uri() + ("?mode=ro" if has_log else "?immutable=1")
    with contextlib.closing(sqlite3.connect(uri, uri=True)) as connection:
        (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
        if verdict != "ok":
            raise _Damaged(verdict)
        return {table: _rows_of(connection, table) for table in _TABLES}


def _is_text(cell: object) -> bool:
    """Whether a cell is text that sqlite would take again."""
    try:
        return isinstance(cell, str) and bool(cell.encode() or True)
    except UnicodeEncodeError:
        return False
