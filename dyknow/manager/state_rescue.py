# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The rescue of a state file that cannot be opened, or is damaged.

The file is read from a private copy, with which no other program interferes and for which there is
room in memory: a file is damaged if its copy is. Rows that can be read go to a new file, and the
old one is set aside.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sqlite3
import tempfile
import time
from pathlib import Path
from typing import Optional, Tuple

from dyknow.errors import StoreError
from dyknow.manager.state_tables import (
    TABLES,
    Damaged,
    Rows,
    cells,
    check,
    connect,
    decoded,
    put,
    rows_of,
)

#: Bytes of a page, as sqlite makes files, and where the first page has a count that says whether
#: the number of pages besides it can be trusted.
_PAGE = 4096
_COUNTS_CHANGES = 95


def rescue(path: str) -> Tuple[Rows, str]:
    """Read a file that could not be opened.

    No connection of this process may have the file open: reading the file releases its locks.

    Returns:
        Its rows, and what is damaged; empty if nothing is.

    Raises:
        StoreError: it cannot be read at all.
    """
    try:
        with tempfile.TemporaryDirectory(prefix="dyknow-", dir=_scratch()) as folder:
            copy = os.path.join(folder, "state")
            for suffix in ("", "-wal"):
                if os.path.exists(path + suffix):
                    shutil.copyfile(path + suffix, copy + suffix)
            return _read_copy(copy)
    except (OSError, sqlite3.OperationalError) as error:
        try:
            return _read_in_place(path), ""
        except (sqlite3.Error, Damaged):
            raise StoreError(path, f"it cannot be read: {error}") from error


def replace_file(path: str, rows: Rows) -> str:
    """Begin a new file with these rows; the old one is set aside once the new one is complete.

    Returns:
        Where the old file is.

    Raises:
        sqlite3.Error, OSError: it did not work.
    """
    new = path + ".new"
    for suffix in ("", "-wal", "-shm"):
        with contextlib.suppress(FileNotFoundError):
            os.remove(new + suffix)
    with contextlib.closing(connect(new, 0.0)) as connection:
        put(
            connection,
            {(table, key): text for table in rows for key, text in rows[table].items()},
        )
    aside = free_name(path)
    for suffix in ("-wal", "-shm", ""):
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


def _scratch() -> Optional[str]:
    """Folder for a private copy: in memory, so that no disk has to have room for it."""
    memory = "/dev/shm"
    return memory if os.access(memory, os.W_OK) else None


def _read_copy(copy: str) -> Tuple[Rows, str]:
    """Read a copy of a file; returns its rows and what is damaged.

    Raises:
        sqlite3.OperationalError: there is no room to read it.
    """
    try:
        with contextlib.closing(connect(copy, 0.0)) as connection:
            return {table: rows_of(connection, table) for table in TABLES}, ""
    except (sqlite3.Error, Damaged) as error:
        if isinstance(error, sqlite3.OperationalError) and "disk is full" in str(error):
            raise
        damage = str(error)
    rows = _salvaged(copy)
    if not any(rows.values()):
        _renew_first_page(copy)
        rows = _salvaged(copy)
    return rows, damage


def _salvaged(copy: str) -> Rows:
    """Read what can be read of a damaged file."""
    rows: Rows = {table: {} for table in TABLES}
    with contextlib.closing(sqlite3.connect(copy, isolation_level=None)) as connection:
        connection.text_factory = decoded
        for table in TABLES:
            for order in ("ASC", "DESC"):  # from both ends to where it is damaged
                with contextlib.suppress(sqlite3.Error, UnicodeDecodeError):
                    for key, text in cells(connection, table, order):
                        if _is_text(key) and _is_text(text):
                            rows[table][key] = text
    return rows


def _renew_first_page(copy: str) -> None:
    """Replace the page without which no other can be read: it is the same in all state files."""
    with contextlib.closing(connect(copy + ".fresh", 0.0)):
        pass
    with open(copy + ".fresh", "rb") as fresh, open(copy, "r+b") as file:
        page = bytearray(fresh.read(_PAGE))
        page[_COUNTS_CHANGES] ^= 0xFF  # no longer the valid count, so the size of the file holds
        file.write(page)


def _read_in_place(path: str) -> Rows:
    """Read a sound file of which no copy can be made.

    Raises:
        sqlite3.Error, Damaged: it cannot be read so.
    """
    has_log = os.path.exists(path + "-wal") and os.path.getsize(path + "-wal") > 0
    uri = Path(os.path.abspath(path)).as_uri() + ("?mode=ro" if has_log else "?immutable=1")
    with contextlib.closing(sqlite3.connect(uri, uri=True)) as connection:
        check(connection)
        return {table: rows_of(connection, table) for table in TABLES}


def _is_text(cell: object) -> bool:
    """Whether a cell is text that sqlite would take again."""
    try:
        return isinstance(cell, str) and bool(cell.encode() or True)
    except UnicodeEncodeError:
        return False
