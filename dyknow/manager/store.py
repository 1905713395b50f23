"""Durable state: what the manager promised, kept over ``kill -9``.

One sqlite file. A transaction is on disk for every other process before its call returns, so what
was acknowledged is there after the manager was killed at any moment. A file that cannot be read
is set aside, never overwritten.
"""

from __future__ import annotations

import json
import os
import sqlite3
import threading
import time
from typing import Any, Dict, Iterable, List, Optional, Sequence, Tuple

from dyknow.errors import StoreError
from dyknow.manager.model import Record, State
from dyknow.manager.specifications.transformation import Parameter, Port, Transformation

#: Changes with the tables.
FORMAT = 1
_IN_MEMORY = ":memory:"

_TABLES = """
CREATE TABLE IF NOT EXISTS facts (
  name TEXT PRIMARY KEY, value TEXT NOT NULL
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS transformations (
  label TEXT PRIMARY KEY, body TEXT NOT NULL
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS nodelets (
  name TEXT PRIMARY KEY, body TEXT NOT NULL
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS claims (
  id TEXT PRIMARY KEY, body TEXT NOT NULL
) WITHOUT ROWID;
"""


def pack(transformation: Transformation) -> str:
    """Write a transformation as one line of JSON."""
    return json.dumps(transformation, separators=(",", ":"))


def unpack(body: str) -> Transformation:
    """Read what ``pack`` wrote."""
    label, source, kind, cost, parameters, ports = json.loads(body)
    return Transformation(
        label,
        source,
        kind,
        cost,
        tuple(Parameter(*each) for each in parameters),
        tuple(Port(name, side, datatype, tuple(tags)) for name, side, datatype, tags in ports),
    )


class Store:
    """The manager's state on disk; every method is safe from any thread."""

    def __init__(self, path: str = _IN_MEMORY) -> None:
        """Open the state, or start an empty one.

        Args:
            path: the file; the default keeps everything in memory.

        Raises:
            StoreError: the folder cannot be written.
        """
        self.path = path
        #: What was wrong with the file that was found, and where it was put; empty if all is well.
        self.complaint = ""
        self._lock = threading.Lock()
        self._connection = self._open()

    # Facts: small numbers that outlive the process

    def number(self, name: str) -> int:
        """Read a number, 0 if it was never written."""
        rows = self._read("SELECT value FROM facts WHERE name = ?", (name,))
        return int(rows[0][0]) if rows else 0

    def set_number(self, name: str, value: int) -> None:
        """Write a number."""
        self._write([("REPLACE INTO facts VALUES (?, ?)", [(name, str(value))])])

    # Transformations

    def transformations(self) -> List[Transformation]:
        """Read all, by label."""
        rows = self._read("SELECT body FROM transformations ORDER BY label")
        return [unpack(body) for (body,) in rows]

    def put_transformations(
        self, transformations: Iterable[Transformation], library_revision: int
    ) -> None:
        """Add or replace, all of them or none."""
        rows = [(each.label, pack(each)) for each in transformations]
        self._write(
            [
                ("REPLACE INTO transformations VALUES (?, ?)", rows),
                ("REPLACE INTO facts VALUES ('library_revision', ?)", [(str(library_revision),)]),
            ]
        )

    def remove_transformation(self, label: str, library_revision: int) -> None:
        """Remove one."""
        self._write(
            [
                ("DELETE FROM transformations WHERE label = ?", [(label,)]),
                ("REPLACE INTO facts VALUES ('library_revision', ?)", [(str(library_revision),)]),
            ]
        )

    # Nodelets

    def nodelets(self) -> List[Record]:
        """Read all records, by name."""
        rows = self._read("SELECT name, body FROM nodelets ORDER BY name")
        return [_record(name, json.loads(body)) for name, body in rows]

    def put_nodelet(self, record: Record) -> None:
        """Add or replace the record of a nodelet."""
        self._write([("REPLACE INTO nodelets VALUES (?, ?)", [(record.name, _body(record))])])

    def remove_nodelet(self, name: str) -> None:
        """Forget a nodelet."""
        self._write([("DELETE FROM nodelets WHERE name = ?", [(name,)])])

    # Claims, as their owner writes them

    def claims(self) -> Dict[str, Dict[str, Any]]:
        """Read all claims, by id."""
        rows = self._read("SELECT id, body FROM claims ORDER BY id")
        return {claim_id: json.loads(body) for claim_id, body in rows}

    def put_claim(self, claim_id: str, body: Dict[str, Any]) -> None:
        """Add or replace a claim."""
        self._write([("REPLACE INTO claims VALUES (?, ?)", [(claim_id, json.dumps(body))])])

    def remove_claim(self, claim_id: str) -> None:
        """Forget a claim."""
        self._write([("DELETE FROM claims WHERE id = ?", [(claim_id,)])])

    def end(self) -> None:
        """Forget nodelets and claims: the manager is stopped on purpose. Transformations stay."""
        self._write([("DELETE FROM nodelets", [()]), ("DELETE FROM claims", [()])])

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._connection.close()

    # Inside

    def _open(self) -> sqlite3.Connection:
        if self.path != _IN_MEMORY:
            try:
                os.makedirs(os.path.dirname(os.path.abspath(self.path)), exist_ok=True)
            except OSError as error:
                raise StoreError(self.path, error) from error
        try:
            return self._connect()
        except (sqlite3.DatabaseError, ValueError, TypeError) as error:
            if self.path == _IN_MEMORY or _cannot_open(error):
                raise StoreError(self.path, error) from error
            self._set_aside(error)
        try:
            return self._connect()
        except sqlite3.DatabaseError as error:
            raise StoreError(self.path, error) from error

    def _connect(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self.path, check_same_thread=False, isolation_level=None)
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = NORMAL")
            connection.executescript(_TABLES)
            (found,) = connection.execute("PRAGMA user_version").fetchone()
            if found not in (0, FORMAT):
                raise ValueError(f"it has format {found}, this program writes format {FORMAT}")
            connection.execute(f"PRAGMA user_version = {FORMAT}")
            (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
            if verdict != "ok":
                raise ValueError(verdict)
            self._check(connection)
        except BaseException:
            connection.close()
            raise
        return connection

    @staticmethod
    def _check(connection: sqlite3.Connection) -> None:
        for name, body in connection.execute("SELECT name, body FROM nodelets"):
            _record(name, json.loads(body))
        for (body,) in connection.execute("SELECT body FROM claims"):
            json.loads(body)
        for (value,) in connection.execute("SELECT value FROM facts"):
            int(value)

    def _set_aside(self, error: Exception) -> None:
        aside = f"{self.path}.broken-{time.strftime('%Y%m%d-%H%M%S')}"
        for suffix in ("", "-wal", "-shm"):
            if os.path.exists(self.path + suffix):
                os.replace(self.path + suffix, aside + suffix)
        self.complaint = (
            f"state file '{self.path}' could not be used ({error}); it was set aside as "
            f"'{aside}' and an empty one was begun"
        )

    def _read(self, query: str, arguments: Sequence[Any] = ()) -> List[Tuple[Any, ...]]:
        with self._lock:
            try:
                return self._connection.execute(query, arguments).fetchall()
            except sqlite3.Error as error:
                raise StoreError(self.path, error) from error

    def _write(self, changes: Sequence[Tuple[str, Sequence[Tuple[Any, ...]]]]) -> None:
        with self._lock:
            try:
                self._connection.execute("BEGIN IMMEDIATE")
                try:
                    for statement, rows in changes:
                        self._connection.executemany(statement, rows)
                    self._connection.execute("COMMIT")
                except BaseException:
                    self._connection.execute("ROLLBACK")
                    raise
            except sqlite3.Error as error:
                raise StoreError(self.path, error) from error


def _cannot_open(error: Exception) -> bool:
    return isinstance(error, sqlite3.OperationalError) and "unable to open" in str(error)


def _body(record: Record) -> str:
    made_from: Optional[str] = pack(record.transformation) if record.transformation else None
    return json.dumps(
        {
            "transformation": made_from,
            "manager": record.manager,
            "is_protected": record.is_protected,
            "isolated": record.isolated,
            "rewired_by_reload": record.rewired_by_reload,
            "topics": dict(record.topics),
            "state": int(record.state),
            "claimed": record.claimed,
            "incarnation": record.incarnation,
        },
        sort_keys=True,
    )


def _record(name: str, body: Dict[str, Any]) -> Record:
    made_from = body.pop("transformation")
    state = State(body.pop("state"))
    return Record(
        name=name, transformation=unpack(made_from) if made_from else None, state=state, **body
    )
