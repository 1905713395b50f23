# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tables of a state file: texts by key, each row with a checksum, in sqlite."""

from __future__ import annotations

import contextlib
import os
import sqlite3
import zlib
from typing import Dict, Iterator, Mapping, Optional, Tuple

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

Changes = Mapping[Tuple[str, str], Optional[str]]
"""Texts by table and key; None for a row that has to go."""
Rows = Dict[str, Dict[str, str]]
"""For each table its texts by key."""


class Damaged(Exception):
    """What is in a file is not what was written."""


def connect(path: str, patience: float) -> sqlite3.Connection:
    """Open a file that is sound and can be written; its tables are made if they are not there.

    Only its owner may read or write a file that is made. One of format 1 gets checksums.

    Args:
        path: the file.
        patience: seconds to wait for another program's lock.

    Raises:
        sqlite3.Error: the file cannot be used now.
        Damaged: what is in it is not what was written.
    """
    make_private(path)
    connection = sqlite3.connect(
        path, timeout=patience, check_same_thread=False, isolation_level=None
    )
    try:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        found = all_rows(connection)
        if _format_of(connection) != FORMAT:
            _make_tables(connection, found)
        connection.execute(f"PRAGMA user_version = {FORMAT}")  # shows whether it can be written
    except BaseException:
        connection.close()
        raise
    return connection


def make_private(path: str) -> None:
    """Let only its owner use a file, which is made if need be, and what belongs to it."""
    if path == ":memory:":
        return
    with contextlib.suppress(OSError):
        os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o600))
    for suffix in ("", "-wal", "-shm"):
        with contextlib.suppress(OSError):
            os.chmod(path + suffix, 0o600)


def all_rows(connection: sqlite3.Connection) -> Rows:
    """Read all rows of a file, and check it on the way.

    Raises:
        sqlite3.Error: the file cannot be used now.
        Damaged: what is in it is not what was written.
    """
    try:
        (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
        if verdict != "ok":
            raise Damaged(" ".join(verdict.split()))
        found = _format_of(connection)
        if found == 0:
            if connection.execute("SELECT count(*) FROM sqlite_master").fetchone() != (0,):
                raise Damaged("it has tables without a format")
            return {table: {} for table in TABLES}
        if found not in (_WITHOUT_CHECKSUMS, FORMAT):
            raise Damaged(f"it has format {found}, this program writes format {FORMAT}")
        return {table: rows_of(connection, table) for table in TABLES}
    except UnicodeDecodeError as error:
        raise Damaged(str(error)) from error


def rows_of(connection: sqlite3.Connection, table: str) -> Dict[str, str]:
    """Read a table, by key.

    Raises:
        sqlite3.Error: the file cannot be used now.
        Damaged: a row is not what was written.
    """
    found = {}
    # Files of format 1 have no third column.
    for key, text, *checksum in connection.execute(f"SELECT * FROM {table}"):
        if not isinstance(key, str) or not isinstance(text, str):
            raise Damaged(f"a row of {table} is no text")
        if checksum not in ([], [_checksum(table, key, text)]):
            raise Damaged(f"{table} '{key}' is not what was written")
        found[key] = text
    return found


def put(connection: sqlite3.Connection, changes: Changes) -> None:
    """Write rows, all or none.

    Raises:
        sqlite3.Error: they were not written.
    """
    with _transaction(connection):
        _put(connection, changes)


def flat(rows: Rows) -> Dict[Tuple[str, str], Optional[str]]:
    """Return rows as changes that write them all."""
    return {(table, key): text for table in rows for key, text in rows[table].items()}


def _checksum(table: str, key: str, text: str) -> int:
    return zlib.crc32("\0".join((table, key, text)).encode())


def _format_of(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def _make_tables(connection: sqlite3.Connection, rows: Rows) -> None:
    with _transaction(connection):
        for table, (key, text) in TABLES.items():
            connection.execute(f"DROP TABLE IF EXISTS {table}")
            connection.execute(
                f"CREATE TABLE {table} ({key} TEXT PRIMARY KEY, {text} TEXT NOT NULL, "
                "checksum INTEGER NOT NULL) WITHOUT ROWID"
            )
        _put(connection, flat(rows))
        connection.execute(f"PRAGMA user_version = {FORMAT}")


def _put(connection: sqlite3.Connection, changes: Changes) -> None:
    for table, (key, _) in TABLES.items():
        mine = [(row, text) for (where, row), text in changes.items() if where == table]
        connection.executemany(
            f"REPLACE INTO {table} VALUES (?, ?, ?)",
            [(row, text, _checksum(table, row, text)) for row, text in mine if text is not None],
        )
        connection.executemany(
            f"DELETE FROM {table} WHERE {key} = ?", [(row,) for row, text in mine if text is None]
        )


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
