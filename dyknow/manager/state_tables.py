# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tables of a state file: texts by key, in sqlite."""

from __future__ import annotations

import contextlib
import sqlite3
from typing import Dict, Iterator, Mapping, Optional, Tuple

#: Changes with the tables.
FORMAT = 1
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

    Args:
        path: the file.
        patience: seconds to wait for another program's lock.

    Raises:
        sqlite3.Error: the file cannot be used now.
        Damaged: what is in it is not what was written.
    """
    connection = sqlite3.connect(
        path, timeout=patience, check_same_thread=False, isolation_level=None
    )
    try:
        # Bytes that are no UTF-8 are judged where the row is read.
        connection.text_factory = decoded
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        check(connection)
        (found,) = connection.execute("PRAGMA user_version").fetchone()
        if found not in (0, FORMAT):
            raise Damaged(f"it has format {found}, this program writes format {FORMAT}")
        for table, (key, text) in TABLES.items():
            connection.execute(
                f"CREATE TABLE IF NOT EXISTS {table} "
                f"({key} TEXT PRIMARY KEY, {text} TEXT NOT NULL) WITHOUT ROWID"
            )
            (strange,) = connection.execute(
                f"SELECT count(*) FROM {table} "
                f"WHERE typeof({key}) <> 'text' OR typeof({text}) <> 'text'"
            ).fetchone()
            if strange:
                raise Damaged(f"{strange} {table} are no text")
        connection.execute(f"PRAGMA user_version = {FORMAT}")
    except UnicodeDecodeError as error:  # in what sqlite says about a broken schema
        connection.close()
        raise Damaged(f"its schema is broken: {error}") from error
    except BaseException:
        connection.close()
        raise
    return connection


def check(connection: sqlite3.Connection) -> None:
    """Let sqlite check a file.

    Raises:
        Damaged: something is wrong with it.
    """
    (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != "ok":
        raise Damaged(" ".join(verdict.split()))


def decoded(raw: bytes) -> str:
    """Decode a text; bytes that are no UTF-8 become surrogates."""
    return raw.decode("utf-8", "surrogateescape")


def rows_of(connection: sqlite3.Connection, table: str) -> Dict[str, str]:
    """Read a table, by key."""
    return dict(cells(connection, table, "ASC"))


def cells(connection: sqlite3.Connection, table: str, order: str) -> Iterator[Tuple[str, str]]:
    """Yield the keys and texts of a table, by key: ``ASC`` or ``DESC``."""
    key, text = TABLES[table]
    yield from connection.execute(f"SELECT {key}, {text} FROM {table} ORDER BY {key} {order}")


def put(connection: sqlite3.Connection, changes: Changes) -> None:
    """Write rows, all or none.

    Raises:
        sqlite3.Error: they were not written.
    """
    connection.execute("BEGIN IMMEDIATE")
    try:
        for table, (key, _) in TABLES.items():
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
        # After some errors, such as a full disk, sqlite has rolled back by itself.
        if connection.in_transaction:
            with contextlib.suppress(sqlite3.Error):
                connection.execute("ROLLBACK")
        raise
