# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Backups of a state file, and what becomes of a file that cannot be opened or is damaged.

Two backups are beside the file, the last good states of it. A file that cannot be opened is read
from a private copy, with which no other program interferes and for which there is room in memory:
it is damaged if its copy is. Then it is set aside, and the newest good backup takes its place.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sqlite3
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Optional

from dyknow.errors import StoreError
from dyknow.manager.state_tables import (
    TABLES,
    Damaged,
    Rows,
    all_rows,
    connect,
    flat,
    make_private,
    put,
)

#: Names of the backups, the newest first.
_BACKUPS = (".backup", ".backup-2")


@dataclass(frozen=True)
class Found:
    """What there is instead of a file that could not be opened.

    Attributes:
        rows: those of the file or, if it is damaged, of its newest good backup.
        damage: what is damaged; empty if nothing is.
        backup: the backup that the rows are from, with its time; empty if there is none.
    """

    rows: Rows
    damage: str = ""
    backup: str = ""


def back_up(path: str) -> None:
    """Make a backup of a file, as it is at one moment; another one is kept.

    Raises:
        sqlite3.Error, OSError: it cannot be made now.
        Damaged: what is in the file is not what was written.
    """
    new = path + ".backup.new"
    _remove(new)
    make_private(new)
    with contextlib.closing(sqlite3.connect(path)) as source, contextlib.closing(
        sqlite3.connect(new)
    ) as copy:
        source.backup(copy)
    _read_only(new)
    newest, older = (path + ending for ending in _BACKUPS)
    if os.path.exists(newest):
        os.replace(newest, older)
    os.replace(new, newest)


def exists(path: str) -> bool:
    """Whether a file has a backup."""
    return os.path.exists(path + _BACKUPS[0])


def read_instead(path: str) -> Found:
    """Read a file that could not be opened, or its newest good backup.

    No connection of this process may have the file open: reading the file releases its locks.

    Raises:
        StoreError: it is there, and cannot be read at all.
    """
    try:
        with tempfile.TemporaryDirectory(prefix="dyknow-", dir=_scratch()) as folder:
            copy = os.path.join(folder, "state")
            for suffix in ("", "-wal"):
                if os.path.exists(path + suffix):
                    shutil.copyfile(path + suffix, copy + suffix)
            with contextlib.closing(connect(copy, 0.0)) as connection:
                return Found(all_rows(connection))
    except OSError as error:
        return _read_in_place(path, error)
    except (sqlite3.Error, Damaged) as error:
        if isinstance(error, sqlite3.OperationalError) and "disk is full" in str(error):
            return _read_in_place(path, error)
        return newest_backup(path, str(error))


def newest_backup(path: str, damage: str) -> Found:
    """Return what there is instead of a file of which something is damaged."""
    for ending in _BACKUPS:
        backup = path + ending
        with contextlib.suppress(sqlite3.Error, Damaged, OSError):
            rows = _read_only(backup)
            when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(os.path.getmtime(backup)))
            return Found(rows, damage, f"'{backup}' of {when}")
    return Found({table: {} for table in TABLES}, damage)


def replace_file(path: str, rows: Rows) -> str:
    """Begin a new file with these rows; the old one is set aside once the new one is complete.

    Returns:
        Where the old file is.

    Raises:
        sqlite3.Error, OSError: it did not work.
    """
    new = path + ".new"
    _remove(new)
    with contextlib.closing(connect(new, 0.0)) as connection:
        put(connection, flat(rows))
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


def _remove(path: str) -> None:
    for suffix in ("", "-wal", "-shm"):
        with contextlib.suppress(FileNotFoundError):
            os.remove(path + suffix)


def _scratch() -> Optional[str]:
    """Folder for a private copy: in memory, so that no disk has to have room for it."""
    memory = "/dev/shm"
    return memory if os.access(memory, os.W_OK) else None


def _read_in_place(path: str, cause: Exception) -> Found:
    """Read a sound file of which no copy can be made.

    Raises:
        StoreError: it cannot be read so.
    """
    has_log = os.path.exists(path + "-wal") and os.path.getsize(path + "-wal") > 0
    try:
        return Found(_read_only(path, "mode=ro" if has_log else "immutable=1"))
    except (sqlite3.Error, Damaged) as error:
        raise StoreError(path, f"it cannot be read: {cause}") from error


def _read_only(path: str, how: str = "immutable=1") -> Rows:
    uri = f"{Path(os.path.abspath(path)).as_uri()}?{how}"
    with contextlib.closing(sqlite3.connect(uri, uri=True)) as connection:
        return all_rows(connection)
