# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Durable state: the manager's promises, kept over ``kill -9``.

The entries are texts by table and key. All are in memory and in a file of sqlite, where each row
has a checksum. A change is in the file before the call that makes it returns, so an acknowledged
change survives when the manager is killed. No fault of the file stops an operation:

- *Trouble*: the file cannot be read or written now (disk full, read-only, locked by another
  program). It is left alone, and written as soon as that works; ``trouble`` explains it.
- *Damage*: the contents differ from the last write, as sqlite or a checksum says, or the file was
  removed or replaced. What is there is set aside, and the file written again from memory or, at
  the start, from the newest good backup. Two backups are beside the file, the last good states
  of it.
"""

from __future__ import annotations

import collections
import contextlib
import json
import logging
import os
import shutil
import sqlite3
import tempfile
import time
import zlib
from os.path import samestat
from pathlib import Path
from typing import Callable, Dict, Iterator, Mapping, Optional, Tuple, TypeVar

from dyknow.errors import DyKnowError, StoreError
from dyknow.locks import turn_lock

IN_MEMORY = ":memory:"
#: Changes with the tables. Rows had no checksums in format 1, and there were no children before 3.
FORMAT = 3
#: The facts with the labels of each specification file and with the verdicts that forbid parts, in
#: JSON; all other facts are numbers.
LABELS_OF_FILES, BAD_VERDICTS = "labels_of_files", "bad_verdicts"
#: The columns of each table that hold keys and texts.
TABLES = {
    "facts": ("name", "value"),
    "transformations": ("label", "body"),
    "nodelets": ("name", "body"),
    "claims": ("id", "body"),
    "children": ("name", "body"),
}
#: Seconds to wait for another program's lock: at the start, and for each change.
_START_PATIENCE = 5.0
_PATIENCE = 1.0
#: Seconds between two attempts to write pending changes.
_RETRY = 1.0
#: Seconds after which a trouble that goes on is reported again.
_REMINDER = 60.0
#: Bytes at the beginning of each file.
_HEADER = 100
#: Names of the backups, the newest first.
_BACKUPS = (".backup", ".backup-2")
#: A file of sqlite, and its companions.
_SUFFIXES = ("", "-wal", "-shm")

_READ_ONLY = "readonly"
_FULL = "disk is full"
_REFUSED = "disk I/O error"
#: What sqlite says of a file that cannot be used now, and what that means to a user.
_TROUBLES = {
    _FULL: "the disk is full; free some space",
    "lock": "it is locked by another program, such as a backup or an sqlite3 shell; "
    "let that finish, or end it",
    _READ_ONLY: "it is read-only; look at the permissions of the file and its folder and at how "
    "the disk is mounted, or choose another folder (~state_dir)",
    "unable to open": "it cannot be opened; look at the permissions of its folder and whether the "
    "disk is full, or choose another folder (~state_dir)",
    _REFUSED: "the disk does not take it (input/output error); look for a quota, a size "
    "limit or a failing disk",
}
#: Errors of the program, not of the file.
_MISUSE = (sqlite3.ProgrammingError, sqlite3.InterfaceError)
_SUBSTITUTE = "what the manager knows took its place"
#: What reading an entry without a meaning may raise.
_MEANINGLESS = (DyKnowError, ValueError, TypeError, KeyError, AttributeError, RecursionError)

Rows = Dict[Tuple[str, str], str]
"""Texts by table and key."""
Changes = Mapping[Tuple[str, str], Optional[str]]
"""Texts by table and key; None for an entry that has to go."""

_Entry = TypeVar("_Entry")

_log = logging.getLogger("rosout.dyknow")


class _Damaged(Exception):
    """The contents of a file differ from the last write."""


#: What opening or reading a file may raise; sqlite's own words about a damaged one may be damaged.
_FAULTS = (sqlite3.Error, UnicodeDecodeError, _Damaged)


class Store:
    """The manager's state on disk; safe from any thread."""

    def __init__(self, path: str = IN_MEMORY, clock: Callable[[], float] = time.monotonic) -> None:
        """Open the file, or start an empty one; StoreError if it is of no use at all."""
        self.path = path
        #: Why the latest changes are not on disk yet, and the remedy; empty if they are.
        self.trouble = ""
        #: Description of damage and of unusable entries, with their new place; empty for none.
        self.complaint = ""
        self._clock = clock
        self._backup_turn = turn_lock("backup of the state file")
        self._turn = turn_lock("state file")
        self._connection: sqlite3.Connection | None = None
        self._file: os.stat_result | None = None  # the file that has the entries
        self._rows: Rows = {}
        self._pending: dict[tuple[str, str], str | None] = {}  # changes that are not on disk yet
        self._damage = ""  # of the file, until it is replaced
        self._substitute = _SUBSTITUTE  # the log's clause on that
        self._is_new = not os.path.exists(path + _BACKUPS[0])  # to the backups
        self._no_backup = ""  # why there is none of the latest changes
        self._retry_at = self._remind_at = float("-inf")
        if path != IN_MEMORY:
            with self._turn:
                self._start()

    @property
    def remark(self) -> str:
        """Remark for the answer to a request while changes are not on disk; else empty."""
        return f"done, but not on disk yet: {self.trouble}" if self.trouble else ""

    def read(self, table: str, meaning: Callable[[str, str], _Entry]) -> dict[str, _Entry]:
        """Read a table by key; entries without a meaning are moved to a file beside this one.

        ``meaning`` makes an entry of a key and a text.
        """
        found: dict[str, _Entry] = {}
        rejected: list[dict[str, str]] = []
        with self._turn:
            texts = {key: text for (kind, key), text in self._rows.items() if kind == table}
        for key in sorted(texts):
            try:
                found[key] = meaning(key, texts[key])
            except _MEANINGLESS as error:
                cause = f"{type(error).__name__}: {error}"
                rejected.append({"table": table, "key": key, "text": texts[key], "cause": cause})
        if rejected:
            self._reject(rejected)
        return found

    def number(self, name: str) -> int:
        """Read a number among the facts, 0 if it was never written."""
        return int(self.read("facts", _fact).get(name, 0))

    def labels_of_files(self) -> dict[str, list[str]]:
        """Read what was written as the fact ``LABELS_OF_FILES``."""
        return dict(json.loads(str(self.read("facts", _fact).get(LABELS_OF_FILES, "{}"))))

    def bad_verdicts(self) -> dict[str, tuple[bool, float, str, list[str]]]:
        """Read the fact ``BAD_VERDICTS``: by tag the value, time, cause and ids of claims."""
        return dict(json.loads(str(self.read("facts", _fact).get(BAD_VERDICTS, "{}"))))

    def write(self, changes: Changes) -> None:
        """Write entries, all or none: to memory as long as the disk does not take them."""
        with self._turn:
            if self._change(changes) and self._clock() >= self._retry_at:
                self._write()

    def write_later(self, changes: Changes) -> None:
        """Write entries with the next ones, or at the next look."""
        with self._turn:
            self._change(changes)

    def write_pending(self) -> None:
        """Write the pending changes, or a file that is gone, if it is time to try again."""
        with self._turn:
            is_due = self._pending or self.trouble or self._is_gone()
            if is_due and self._clock() >= self._retry_at:
                self._write()

    def end(self) -> None:
        """Forget nodelets, claims and verdicts: the manager is stopped on purpose."""
        with self._turn:
            places = [
                place
                for place in self._rows
                if place[0] in ("nodelets", "claims") or place[1] == BAD_VERDICTS
            ]
        self.write(dict.fromkeys(places))

    def back_up(self) -> None:
        """Make a backup if there is something new; a failure is logged, and tried again later."""
        with self._backup_turn:
            self.write_pending()
            with self._turn:
                if self._connection is None or self.trouble or not self._is_new:
                    return
                self._is_new = False
            try:
                _back_up(self.path)
            except (OSError, *_FAULTS) as error:
                with self._turn:
                    self._is_new = True
                    if not isinstance(error, OSError) and not _trouble(error):
                        self._close(str(error))
                        self._write()
                if str(error) != self._no_backup:
                    self._no_backup = str(error)
                    what = self._meaning(error)
                    _log.warning("state file '%s': no backup: %s", self.path, what)
            else:
                self._no_backup = ""

    def close(self) -> None:
        """Close the file; changes that it does not take are lost."""
        with self._turn:
            if self._pending or self.trouble:
                with contextlib.suppress(StoreError):
                    self._write()
        self.back_up()  # an older one would have forgotten entries
        with self._turn:
            if self._pending:
                _log.error("%s. %d changes are lost", self.trouble, len(self._pending))
            if self._connection is not None:
                self._connection.close()

    # Opening

    def _start(self) -> None:
        try:
            _make_folder(self.path)
            if os.path.exists(self.path + ".new") and not os.path.exists(self.path):
                _put_in_place(self.path)  # killed while it was replaced
            if os.path.exists(self.path):
                self._file = os.stat(self.path)
                if self._file.st_size < _HEADER:
                    self._damage = "it is cut off"
        except OSError as error:
            raise StoreError(self.path, error) from error
        if not self._damage:
            try:
                _, self._rows = self._open(_START_PATIENCE)
                return
            except _FAULTS as error:
                trouble = error
            try:
                self._rows = _read_aside(self.path)
                self._note_trouble(trouble)
                return
            except _Damaged as error:
                self._damage = str(error)
        self._rows, self._substitute = _newest_backup(self.path)
        self._write()

    def _open(self, patience: float) -> tuple[sqlite3.Connection, Rows]:
        self._connection, rows = _open(self.path, patience)
        self._file = os.stat(self.path)
        return self._connection, rows

    def _is_gone(self) -> bool:
        """Whether the file was removed, or another one took its place."""
        try:
            return self._file is not None and not samestat(os.stat(self.path), self._file)
        except OSError as error:
            return isinstance(error, FileNotFoundError)

    def _close(self, damage: str) -> None:
        """Close a file that is to be replaced."""
        if self._connection is not None:
            self._connection.close()
        self._connection, self._damage = None, damage

    def _reopen(self) -> sqlite3.Connection:
        """Open a file that could not be opened the last time; one that is damaged is replaced."""
        if not self._damage:
            try:
                return self._open(0.0)[0]
            except _FAULTS as error:
                if _trouble(error):
                    raise
                self._damage = str(error)
        aside = _replace(self.path, self._rows)
        where = f"it was set aside as '{aside}'; " if os.path.exists(aside) else ""
        connection, _ = self._open(0.0)
        counts = collections.Counter(table for table, _ in self._rows)
        kept = ", ".join(f"{counts[table]} {table}" for table in TABLES if counts[table])
        self._complain(
            f"was damaged ({self._damage}); {where}{self._substitute}, with {kept or 'no entries'}"
        )
        self._damage, self._substitute = "", _SUBSTITUTE
        return connection

    def _complain(self, what: str) -> None:
        complaint = f"state file '{self.path}': {what}"
        self.complaint += ("\n" if self.complaint else "") + complaint
        _log.error("%s", complaint)

    # Writing

    def _change(self, changes: Changes) -> bool:
        """Change the memory; returns whether that differs from the disk now."""
        for place, text in changes.items():
            if self._rows.get(place) == text:
                continue
            self._pending[place] = text
            if text is None:
                del self._rows[place]
            else:
                self._rows[place] = text
        if self.path == IN_MEMORY:
            self._pending.clear()
        return bool(self._pending)

    def _write(self) -> None:
        try:
            if not self._damage and self._is_gone():
                self._close("it was removed or replaced")
            self._put(self._connection or self._reopen())
        except _MISUSE as error:
            raise StoreError(self.path, error) from error
        except (sqlite3.Error, OSError) as error:
            self._note_trouble(error)
        else:
            self._is_new |= bool(self._pending)
            self._pending.clear()
            self._retry_at = float("-inf")
            if self.trouble:
                self.trouble = ""
                self._remind_at = float("-inf")
                _log.warning("state file '%s' is written again; nothing is missing", self.path)

    def _put(self, connection: sqlite3.Connection) -> None:
        patience = 0.0 if self.trouble else _PATIENCE
        try:
            connection.execute(f"PRAGMA busy_timeout = {int(1000 * patience)}")
            _put(connection, self._pending)
        except sqlite3.Error as error:
            if isinstance(error, _MISUSE) or _trouble(error):
                raise
            connection.close()  # damaged while it was open
            self._connection = None
            _put(self._reopen(), self._pending)

    def _reject(self, entries: list[dict[str, str]]) -> None:
        """Move meaningless entries to a file beside this one."""
        what = "; ".join(f"{each['table']} '{each['key']}': {each['cause']}" for each in entries)
        aside = _free_name(self.path, ".json")
        try:
            with open(aside, "w") as file:
                json.dump(entries, file, indent=1)
        except OSError as error:  # they stay where they are until there is room for them
            self._complain(f"entries cannot be used, nor set aside ({error}): {what}")
            return
        self._complain(f"entries cannot be used and were set aside as '{aside}': {what}")
        self.write({(each["table"], each["key"]): None for each in entries})

    # Trouble

    def _note_trouble(self, error: Exception) -> None:
        now = self._clock()
        self._retry_at = now + _RETRY
        why = f"it is damaged ({self._damage}) and cannot be replaced: " if self._damage else ""
        self.trouble = f"state file '{self.path}': {why}{self._meaning(error)}"
        if now >= self._remind_at:
            self._remind_at = now + _REMINDER
            _log.error(
                "%s. The manager goes on; until the file can be written, what changes is kept in "
                "memory, and lost if the manager is killed",
                self.trouble,
            )

    def _meaning(self, error: Exception) -> str:
        """Explain an error, with the remedy."""
        words = _trouble(error)
        if words == "unable to open" and not os.access(os.path.dirname(self.path) or ".", os.W_OK):
            words = _READ_ONLY
        return f"{_TROUBLES[words]} ({error})" if words else str(error)


def _fact(name: str, text: str) -> int | str:
    return text if name in (LABELS_OF_FILES, BAD_VERDICTS) else int(text)


def _trouble(error: BaseException) -> str:
    """Return sqlite's words for a file that cannot be used now; empty for other errors."""
    if isinstance(error, sqlite3.OperationalError):
        for words in _TROUBLES:
            if words in str(error):
                return words
    return ""


# Files of sqlite


def _open(path: str, patience: float) -> tuple[sqlite3.Connection, Rows]:
    """Open a file that is sound and can be written; its tables are made if they are not there.

    Only its owner may read or write a file that is made. One of an earlier format is converted.
    Another program's lock is awaited for so many seconds.

    Raises:
    sqlite3.Error: the file cannot be used now.
    _Damaged: the contents differ from the last write.
    """
    _make_private(path)
    connection = sqlite3.connect(path, patience, check_same_thread=False, isolation_level=None)
    try:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        rows = _rows(connection)
        if _format(connection) != FORMAT:
            with _transaction(connection):
                for table, (key, text) in TABLES.items():
                    connection.execute(f"DROP TABLE IF EXISTS {table}")
                    connection.execute(
                        f"CREATE TABLE {table} ({key} TEXT PRIMARY KEY, {text} TEXT NOT NULL, "
                        "checksum INTEGER NOT NULL) WITHOUT ROWID"
                    )
                connection.execute(f"PRAGMA user_version = {FORMAT}")
                _replace_rows(connection, rows)
        connection.execute(f"PRAGMA user_version = {FORMAT}")  # shows whether it can be written
    except BaseException:
        connection.close()
        raise
    return connection, rows


def _format(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def _rows(connection: sqlite3.Connection) -> Rows:
    """Read all rows of a file, and check it; _Damaged if it is not as it was written."""
    rows: Rows = {}
    (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != "ok":
        raise _Damaged(" ".join(verdict.split()))
    found = _format(connection)
    if found == 0:
        if connection.execute("SELECT count(*) FROM sqlite_master").fetchone() != (0,):
            raise _Damaged("it has tables without a format")
        return rows
    if not 0 < found <= FORMAT:
        raise _Damaged(f"it has format {found}, this program writes format {FORMAT}")
    present = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
    for table in TABLES if found == FORMAT else TABLES.keys() & present:
        # Files of format 1 have no third column.
        for key, text, *checksum in connection.execute(f"SELECT * FROM {table}"):
            if not isinstance(key, str) or not isinstance(text, str):
                raise _Damaged(f"a row of {table} is no text")
            if checksum not in ([], [_checksum(table, key, text)]):
                raise _Damaged(f"{table} '{key}' is not what was written")
            rows[table, key] = text
    return rows


def _put(connection: sqlite3.Connection, changes: Changes) -> None:
    """Write rows, all or none."""
    with _transaction(connection):
        _replace_rows(connection, changes)


def _replace_rows(connection: sqlite3.Connection, changes: Changes) -> None:
    for (table, key), text in changes.items():
        if text is None:
            connection.execute(f"DELETE FROM {table} WHERE {TABLES[table][0]} = ?", (key,))
        else:
            row = (key, text, _checksum(table, key, text))
            connection.execute(f"REPLACE INTO {table} VALUES (?, ?, ?)", row)


def _checksum(table: str, key: str, text: str) -> int:
    return zlib.crc32("\0".join((table, key, text)).encode())


@contextlib.contextmanager
def _transaction(connection: sqlite3.Connection) -> Iterator[None]:
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        # After some errors, such as a full disk, sqlite has rolled back by itself.
        if connection.in_transaction:
            with contextlib.suppress(sqlite3.Error):
                connection.execute("ROLLBACK")
        raise


def _read_only(path: str, how: str = "mode=ro&immutable=1") -> Rows:
    uri = f"{Path(os.path.abspath(path)).as_uri()}?{how}"
    with contextlib.closing(sqlite3.connect(uri, uri=True)) as connection:
        connection.execute("PRAGMA locking_mode = EXCLUSIVE")  # the log's index is in memory
        return _rows(connection)


def _read_aside(path: str) -> Rows:
    """Read a file that could not be opened: a private copy, which no other program has locked.

    The file is damaged if its copy is. No connection of this process may have it open: reading it
    would release its locks.

    Raises:
        _Damaged: it has to be replaced.
        StoreError: it cannot be read at all.
    """
    memory = "/dev/shm"  # no disk has to have room for the copy
    scratch = memory if os.access(memory, os.W_OK) else None
    cause: Exception
    try:
        with tempfile.TemporaryDirectory(prefix="dyknow-", dir=scratch) as folder:
            copy = os.path.join(folder, "state")
            for suffix in ("", "-wal"):
                if os.path.exists(path + suffix):
                    shutil.copyfile(path + suffix, copy + suffix)
            connection, rows = _open(copy, 0.0)
            connection.close()
            return rows
    except OSError as error:
        cause = error
    except _FAULTS as error:
        if _trouble(error) not in (_FULL, _REFUSED):
            raise _Damaged(str(error)) from error
        cause = error
    # No copy can be made; a sound file can be read in place.
    has_log = os.path.exists(path + "-wal") and os.path.getsize(path + "-wal") > 0
    try:
        return _read_only(path, "mode=rw") if has_log else _read_only(path)
    except _FAULTS as error:
        if _trouble(cause) == _REFUSED:
            raise _Damaged(str(cause)) from error
        raise StoreError(path, f"it cannot be read: {cause}") from error


def _replace(path: str, rows: Rows) -> str:
    """Write a new file with these rows; the old one is set aside, to the path that is returned."""
    new = path + ".new"
    _make_folder(path)
    _remove(new)
    connection, _ = _open(new, 0.0)
    with contextlib.closing(connection):
        _put(connection, rows)
    return _put_in_place(path)


def _put_in_place(path: str) -> str:
    """Set a file aside, to the path that is returned, and put the new one in its place.

    The file goes first: once it is gone, the new one counts. Without its log it would be an older
    state, and its log in the new one's place would be taken for that one's.
    """
    aside = _free_name(path)
    for suffix in _SUFFIXES:
        if os.path.exists(path + suffix):
            os.replace(path + suffix, aside + suffix)
    os.replace(path + ".new", path)
    return aside


def _back_up(path: str) -> None:
    """Make a backup of a file, as it is at one moment; the one before it is kept."""
    new = path + ".backup.new"
    _remove(new)
    _make_private(new)
    with contextlib.closing(sqlite3.connect(path)) as source, contextlib.closing(
        sqlite3.connect(new)
    ) as copy:
        source.backup(copy)
    _read_only(new)
    newest, older = (path + ending for ending in _BACKUPS)
    if os.path.exists(newest):
        os.replace(newest, older)
    os.replace(new, newest)


def _newest_backup(path: str) -> tuple[Rows, str]:
    """Return the rows of the newest good backup, and the log's clause on it."""
    for ending in _BACKUPS:
        backup = path + ending
        with contextlib.suppress(OSError, *_FAULTS):
            rows = _read_only(backup)
            when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(os.path.getmtime(backup)))
            return rows, f"the backup '{backup}' of {when} took its place"
    return {}, "there is no good backup of it: a new file was begun"


def _free_name(path: str, ending: str = "") -> str:
    """Name a file, beside ``path``, that does not exist."""
    base = f"{path}.broken-{time.strftime('%Y%m%d-%H%M%S')}"
    name, count = base + ending, 1
    while os.path.exists(name):
        count += 1
        name = f"{base}-{count}{ending}"
    return name


def _make_folder(path: str) -> None:
    os.makedirs(os.path.dirname(os.path.abspath(path)), 0o700, exist_ok=True)


def _make_private(path: str) -> None:
    """Make a file if need be, and let only its owner use it and its companions."""
    with contextlib.suppress(OSError):
        os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o600))
    for suffix in _SUFFIXES:
        with contextlib.suppress(OSError):
            os.chmod(path + suffix, 0o600)


def _remove(path: str) -> None:
    for suffix in _SUFFIXES:
        with contextlib.suppress(FileNotFoundError):
            os.remove(path + suffix)
