# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A state file on the disk: its tables in sqlite, its backups, and its replacement if damaged.

The tables hold texts by key, each row with a checksum. Two backups are beside the file, the last
good states of it. A file that cannot be opened is read from a private copy, with which no other
program interferes and for which there is room in memory: it is damaged if its copy is. Then it is
set aside, and the newest good backup takes its place.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sqlite3
import tempfile
import time
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterator, Mapping, Optional, Tuple

from dyknow.errors import StoreError

#: Changes with the tables. Rows had no checksums in format 1.
FORMAT = 2
_WITHOUT_CHECKSUMS = 1
#: The columns of each table that hold keys and texts.
TABLES = {
    "facts": ("name", "value"),
    "transformations": ("label", "body"),
    "nodelets": ("name", "body"),
    "claims": ("id", "body"),
}
#: Names of the backups, the newest first.
_BACKUPS = (".backup", ".backup-2")
#: A file of sqlite, and its companions.
_SUFFIXES = ("", "-wal", "-shm")

Rows = Dict[Tuple[str, str], str]
"""Texts by table and key."""
Changes = Mapping[Tuple[str, str], Optional[str]]
"""Texts by table and key; None for a row that has to go."""


class Damaged(Exception):
    """The contents of a file differ from the last write."""


@dataclass(frozen=True)
class Found:
    """What there is instead of a file that could not be opened."""

    rows: Rows
    damage: str = ""
    backup: str = ""


def connect(path: str, patience: float) -> sqlite3.Connection:
    """Open a file that is sound and can be written; its tables are made if they are not there.

    Only its owner may read or write a file that is made. One of format 1 gets checksums.

    Args:
        path: the file.
        patience: seconds to wait for another program's lock.

    Raises:
        sqlite3.Error: the file cannot be used now.
        Damaged: the contents differ from the last write.
    """
    _make_private(path)
    connection = sqlite3.connect(
        path, timeout=patience, check_same_thread=False, isolation_level=None
    )
    try:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        rows = read(connection)
        if _format_of(connection) != FORMAT:
            with _transaction(connection):
                for table, (key, text) in TABLES.items():
                    connection.execute(f"DROP TABLE IF EXISTS {table}")
                    connection.execute(
                        f"CREATE TABLE {table} ({key} TEXT PRIMARY KEY, {text} TEXT NOT NULL, "
                        "checksum INTEGER NOT NULL) WITHOUT ROWID"
                    )
                _put(connection, rows)
                connection.execute(f"PRAGMA user_version = {FORMAT}")
        connection.execute(f"PRAGMA user_version = {FORMAT}")  # shows whether it can be written
    except BaseException:
        connection.close()
        raise
    return connection


def read(connection: sqlite3.Connection) -> Rows:
    """Read all rows of a file, and check it on the way; Damaged if it is not as it was written."""
    try:
        (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
        if verdict != "ok":
            raise Damaged(" ".join(verdict.split()))
        found = _format_of(connection)
        if found == 0:
            if connection.execute("SELECT count(*) FROM sqlite_master").fetchone() != (0,):
                raise Damaged("it has tables without a format")
            return {}
        if found not in (_WITHOUT_CHECKSUMS, FORMAT):
            raise Damaged(f"it has format {found}, this program writes format {FORMAT}")
        return {(table, key): text for table in TABLES for key, text in rows_of(connection, table)}
    except UnicodeDecodeError as error:
        raise Damaged(str(error)) from error


def rows_of(connection: sqlite3.Connection, table: str) -> Iterator[tuple[str, str]]:
    """Read a table: keys with their texts; Damaged if a row differs from the last write."""
    # Files of format 1 have no third column.
    for key, text, *checksum in connection.execute(f"SELECT * FROM {table}"):
        if not isinstance(key, str) or not isinstance(text, str):
            raise Damaged(f"a row of {table} is no text")
        if checksum not in ([], [_checksum(table, key, text)]):
            raise Damaged(f"{table} '{key}' is not what was written")
        yield key, text


def put(connection: sqlite3.Connection, changes: Changes) -> None:
    """Write rows, all or none."""
    with _transaction(connection):
        _put(connection, changes)


def changed(rows: Rows, changes: Changes) -> Rows:
    after = {**rows, **changes}
    return {where: text for where, text in after.items() if text is not None}


# Backups


def back_up(path: str) -> None:
    """Make a backup of a file, as it is at one moment; the one before it is kept."""
    new = path + ".backup.new"
    _remove(new)
    _make_private(new)
    with contextlib.ExitStack() as opened:
        source, copy = (
            opened.enter_context(contextlib.closing(sqlite3.connect(each))) for each in (path, new)
        )
        source.backup(copy)
    _read_only(new)
    newest, older = (path + ending for ending in _BACKUPS)
    if os.path.exists(newest):
        os.replace(newest, older)
    os.replace(new, newest)


def has_backup(path: str) -> bool:
    return os.path.exists(path + _BACKUPS[0])


def newest_backup(path: str, damage: str) -> Found:
    """Return what there is instead of a file of which something is damaged."""
    for ending in _BACKUPS:
        backup = path + ending
        with contextlib.suppress(sqlite3.Error, Damaged, OSError):
            rows = _read_only(backup)
            when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(os.path.getmtime(backup)))
            return Found(rows, damage, f"'{backup}' of {when}")
    return Found({}, damage)


def read_instead(path: str) -> Found:
    """Read a file that could not be opened, or its newest good backup.

    No connection of this process may have the file open: reading the file releases its locks.

    Raises:
        StoreError: it is there, and cannot be read at all.
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
            with contextlib.closing(connect(copy, 0.0)) as connection:
                return Found(read(connection))
    except OSError as error:
        cause = error
    except (sqlite3.Error, Damaged) as error:
        if not (isinstance(error, sqlite3.OperationalError) and "disk is full" in str(error)):
            return newest_backup(path, str(error))
        cause = error
    # No copy can be made; a sound file can be read in place.
    has_log = os.path.exists(path + "-wal") and os.path.getsize(path + "-wal") > 0
    try:
        return Found(_read_only(path, "mode=ro" if has_log else "immutable=1"))
    except (sqlite3.Error, Damaged) as error:
        raise StoreError(path, f"it cannot be read: {cause}") from error


def replace_file(path: str, rows: Rows) -> str:
    """Write a new file with these rows; the old one is set aside, to the path that is returned."""
    new = path + ".new"
    _remove(new)
    with contextlib.closing(connect(new, 0.0)) as connection:
        put(connection, rows)
    aside = free_name(path)
    for suffix in reversed(_SUFFIXES):
        if os.path.exists(path + suffix):
            os.replace(path + suffix, aside + suffix)
    os.replace(new, path)
    return aside


def finish_replacement(path: str) -> None:
    """Complete a replacement during which the manager was killed: only the new file is left."""
    if os.path.exists(path + ".new") and not os.path.exists(path):
        os.replace(path + ".new", path)


def free_name(path: str, ending: str = "") -> str:
    """Name a file, beside ``path``, that does not exist."""
    base = f"{path}.broken-{time.strftime('%Y%m%d-%H%M%S')}"
    name, count = base + ending, 1
    while os.path.exists(name):
        count += 1
        name = f"{base}-{count}{ending}"
    return name


# Inside


def _make_private(path: str) -> None:
    """Make a file if need be, and let only its owner use it and its companions."""
    if path == ":memory:":
        return
    with contextlib.suppress(OSError):
        os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o600))
    for suffix in _SUFFIXES:
        with contextlib.suppress(OSError):
            os.chmod(path + suffix, 0o600)


def _remove(path: str) -> None:
    for suffix in _SUFFIXES:
        with contextlib.suppress(FileNotFoundError):
            os.remove(path + suffix)


def _read_only(path: str, how: str = "immutable=1") -> Rows:
    uri = f"{Path(os.path.abspath(path)).as_uri()}?{how}"
    with contextlib.closing(sqlite3.connect(uri, uri=True)) as connection:
        return read(connection)


def _checksum(table: str, key: str, text: str) -> int:
    return zlib.crc32("\0".join((table, key, text)).encode())


def _format_of(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def _put(connection: sqlite3.Connection, changes: Changes) -> None:
    for (table, key), text in changes.items():
        if text is None:
            connection.execute(f"DELETE FROM {table} WHERE {TABLES[table][0]} = ?", (key,))
        else:
            row = (key, text, _checksum(table, key, text))
            connection.execute(f"REPLACE INTO {table} VALUES (?, ?, ?)", row)


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
