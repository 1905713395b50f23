# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A file of texts by table and key, on a disk that may fail.

A write is on disk, for every other process, before the call returns. There are two kinds of fault:

- *Trouble*: the file cannot be read or written now (disk full, read-only, locked by another
  program). The file is left alone. Its rows are read from a private copy if need be, changes are
  kept in memory, and both go to the file as soon as it can be written.
- *Damage*: the contents differ from the last write: a checksum of a row, or sqlite, says so. The
  file is set aside, and the newest good backup takes its place (``state_tables``), with the
  changes that this process has written since then.
"""

from __future__ import annotations

import collections
import contextlib
import json
import logging
import os
import sqlite3
import time
from dataclasses import replace
from typing import Callable, Mapping

from dyknow.errors import StoreError
from dyknow.locks import turn_lock
from dyknow.manager import state_tables
from dyknow.manager.state_tables import TABLES, Changes, Damaged, Found, changed, connect, put

IN_MEMORY = ":memory:"
#: Seconds to wait for another program's lock: at the start, and for each change.
_START_PATIENCE = 5.0
_PATIENCE = 1.0
#: Bytes at the beginning of each file.
_HEADER = 100
#: Seconds between two attempts to write pending changes.
_RETRY = 1.0
#: Seconds after which a trouble that goes on is reported again.
_REMINDER = 60.0

_READ_ONLY = "readonly"
#: What sqlite says of a file that cannot be used now, and what that means to a user.
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
#: Errors of the program, not of the file.
_MISUSE = (sqlite3.ProgrammingError, sqlite3.InterfaceError)

_log = logging.getLogger("rosout.dyknow")


class StateFile:
    """Texts by table and key; safe from any thread."""

    def __init__(self, path: str, clock: Callable[[], float] = time.monotonic) -> None:
        """Open the file, or start an empty one; StoreError if it is of no use at all."""
        self.path = path
        #: Why the latest changes are not on disk yet, and what to do; empty if they are.
        self.trouble = ""
        #: Description of the damage, with the new place of the file; empty for none.
        self.complaint = ""
        self._clock = clock
        self._backup_turn = turn_lock("backup of the state file")
        self._turn = turn_lock("state file")
        self._connection: sqlite3.Connection | None = None
        self._found: Found | None = None  # instead of a file that is not open
        #: Changes since the last backup: with a backup they make the whole.
        self._since_backup: dict[tuple[str, str], str | None] = {}
        self._no_backup = ""  # why there is none of the latest changes
        self._pending: dict[tuple[str, str], str | None] = {}
        self._retry_at = self._remind_at = float("-inf")
        with self._turn:
            self._start()

    def rows(self, table: str) -> dict[str, str]:
        """Read a table, by key."""
        with self._turn:
            stored = {(table, key): text for key, text in self._stored(table).items()}
            rows = changed(stored, self._pending)
        return {key: text for (kind, key), text in sorted(rows.items()) if kind == table}

    def write(self, changes: Changes) -> None:
        """Write rows, all or none: to the disk or, as long as it does not take them, to memory."""
        with self._turn:
            if self.trouble and self._clock() < self._retry_at:
                self._pending.update(changes)
            else:
                self._write({**self._pending, **changes})

    def write_pending(self) -> None:
        """Write the pending changes, if there are any and it is time to try again."""
        with self._turn:
            if self.trouble and self._clock() >= self._retry_at:
                self._write(self._pending)

    def reject(self, table: str, causes: Mapping[str, str]) -> None:
        """Move meaningless rows of a table to a file beside this one, with the causes by key."""
        with self._turn:
            what = "; ".join(f"{table} '{key}': {causes[key]}" for key in sorted(causes))
            removed: Changes = {(table, key): None for key in causes}
            if self.path == IN_MEMORY:
                self._complain(f"entries cannot be used: {what}")
                self._write(removed)
                return
            known = self._stored(table)
            rejected = [
                {"table": table, "key": key, "text": known.get(key), "cause": causes[key]}
                for key in sorted(causes)
            ]
            aside = state_tables.free_name(self.path, ".json")
            try:
                with open(aside, "w") as file:
                    json.dump(rejected, file, indent=1)
            except OSError as error:  # they stay where they are until there is room for them
                self._complain(f"entries cannot be used, nor set aside ({error}): {what}")
                return
            self._complain(f"entries cannot be used and were set aside as '{aside}': {what}")
            self._write({**self._pending, **removed})

    def back_up(self) -> None:
        """Make a backup if there is something new; a failure is logged, and tried again later."""
        with self._backup_turn:
            with self._turn:
                if self.path == IN_MEMORY or self._connection is None or self.trouble:
                    return
                new, self._since_backup = self._since_backup, {}
            if not new and state_tables.has_backup(self.path):
                return
            try:
                state_tables.back_up(self.path)
            except (sqlite3.Error, OSError, Damaged) as error:
                with self._turn:
                    self._since_backup = {**new, **self._since_backup}
                    if not isinstance(error, OSError) and not _trouble(error):
                        self._find_damage()
                if str(error) != self._no_backup:
                    self._no_backup = str(error)
                    what = self._meaning(error)
                    _log.warning("state file '%s': no backup: %s", self.path, what)
            else:
                self._no_backup = ""

    def close(self) -> None:
        """Close the file; pending changes are lost."""
        self.back_up()  # an older one would have forgotten entries
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
                os.makedirs(os.path.dirname(os.path.abspath(self.path)), 0o700, exist_ok=True)
                state_tables.finish_replacement(self.path)
                if os.path.exists(self.path) and os.path.getsize(self.path) < _HEADER:
                    self._found = state_tables.newest_backup(self.path, "it is cut off")
                    self._write({})
                    return
            except OSError as error:
                raise StoreError(self.path, error) from error
        try:
            self._connection = connect(self.path, _START_PATIENCE)
        except (sqlite3.Error, Damaged) as error:
            self._found = state_tables.read_instead(self.path)
            if not self._found.damage:
                self._note_trouble(error)
                return
            self._write({})

    def _reopen(self) -> None:
        """Open a file that could not be opened, or was damaged, the last time."""
        if self._found is None:
            found = state_tables.read_instead(self.path)
            if found.damage:  # the backup lacks what this process has written since
                found = replace(found, rows=changed(found.rows, self._since_backup))
            self._found = found
        if not self._found.damage:
            try:
                self._connection = connect(self.path, 0.0)
            except (sqlite3.Error, Damaged) as error:
                if _trouble(error):
                    raise
                self._found = replace(self._found, damage=str(error))
        if self._found.damage:
            self._replace(self._found)
        self._found = None

    def _find_damage(self) -> None:
        """Look whether an open file is damaged, and replace it if it is."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        self._write(self._pending)

    def _replace(self, found: Found) -> None:
        aside = state_tables.replace_file(self.path, found.rows)
        self._connection = connect(self.path, 0.0)
        counts = collections.Counter(table for table, _ in found.rows)
        kept = ", ".join(f"{counts[table]} {table}" for table in TABLES if counts[table])
        instead = (
            f"the backup {found.backup} took its place, with {kept or 'no entries'}"
            if found.backup
            else "there is no good backup of it: a new file was begun"
            + (f", with {kept}" if kept else "")
        )
        self._complain(f"was damaged ({found.damage}); it was set aside as '{aside}'; {instead}")

    def _complain(self, what: str) -> None:
        complaint = f"state file '{self.path}': {what}"
        self.complaint += ("\n" if self.complaint else "") + complaint
        _log.error("%s", complaint)

    # Reading and writing

    def _stored(self, table: str) -> dict[str, str]:
        if self._found is not None:
            return {key: text for (kind, key), text in self._found.rows.items() if kind == table}
        if self._connection is None:
            raise StoreError(self.path, self.trouble)
        try:
            return dict(state_tables.rows_of(self._connection, table))
        except (sqlite3.Error, Damaged) as error:
            raise StoreError(self.path, error) from error

    def _write(self, changes: Changes) -> None:
        try:
            if self._connection is None:
                self._reopen()
            self._put(changes)
        except _MISUSE as error:
            raise StoreError(self.path, error) from error
        except (sqlite3.Error, OSError, StoreError) as error:
            self._pending = dict(changes)
            self._note_trouble(error)
        else:
            self._pending = {}
            if self.path != IN_MEMORY:
                self._since_backup.update(changes)
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
            put(connection, changes)
        except _MISUSE:
            raise
        except sqlite3.Error as error:
            if _trouble(error) or self.path == IN_MEMORY:
                raise
            connection.close()  # damaged while it was open
            self._connection = None
            self._reopen()
            assert self._connection is not None
            put(self._connection, changes)

    def _note_trouble(self, error: Exception) -> None:
        now = self._clock()
        self._retry_at = now + _RETRY
        damaged = (
            f"it is damaged ({self._found.damage}) and cannot be replaced: "
            if self._found is not None and self._found.damage
            else ""
        )
        self.trouble = f"state file '{self.path}': {damaged}{self._meaning(error)}"
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


def _trouble(error: BaseException) -> str:
    """Return sqlite's words for a file that cannot be used now; empty for other errors."""
    if isinstance(error, sqlite3.OperationalError):
        for words in _TROUBLES:
            if words in str(error):
                return words
    return ""
