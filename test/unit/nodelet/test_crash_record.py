# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelets at work are known after the process has died, whatever the cause."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from clocks import PATIENCE, in_thread, join

from dyknow import names
from dyknow.nodelet.crash_record import AtWork, CrashRecord, read

#: A pool of two workers; `/a` ends the process, `/b` blocks, `/c` has run before.
PROGRAM = """
import ctypes, os, sys, threading
from dyknow import names
from dyknow.nodelet.crash_record import CrashRecord
from dyknow.nodelet.scheduler import Strand, WorkerPool

ways = {
    "segfault": lambda: ctypes.string_at(0),
    "exit": lambda: os._exit(3),
    "end": lambda: ended.set(),
}
path, way = sys.argv[1:]
record = CrashRecord(path)
pool = WorkerPool(2, record=record)
a, b, c = (Strand(pool, name, mark=names.mark(name)) for name in ("/a", "/b", "/c"))
ended, blocked = threading.Event(), threading.Event()
c.post(lambda: None)
pool.drain()
b.post(lambda: (blocked.set(), threading.Event().wait()))
blocked.wait()
a.post(ways[way])
ended.wait()
record.close()
"""


def run(path: Path, way: str) -> tuple[int, AtWork]:
    """Let a process end in a given way; returns its exit code and its crash record."""
    process = subprocess.Popen([sys.executable, "-c", PROGRAM, str(path), way])
    code = process.wait(PATIENCE)
    return code, read(str(path), process.pid)


@pytest.mark.parametrize(("way", "code"), [("segfault", -signal.SIGSEGV), ("exit", 3), ("end", 0)])
def test_the_nodelets_at_work_are_known_afterwards(tmp_path: Path, way: str, code: int) -> None:
    at_work = {names.mark("/a"), names.mark("/b")} if code else ()
    assert run(tmp_path / "record", way) == (code, AtWork(frozenset(at_work)))


def test_what_is_no_record_of_the_process_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "record"
    with pytest.raises(OSError, match="No such file"):
        read(str(path), 1)
    path.write_bytes(b"x")
    with pytest.raises(ValueError, match="bytes"):
        read(str(path), 1)
    CrashRecord(str(path))
    with pytest.raises(ValueError, match="of process"):
        read(str(path), os.getpid() + 1)


def test_a_successor_is_not_disturbed_by_a_process_that_still_writes(tmp_path: Path) -> None:
    path = str(tmp_path / "record")
    first = CrashRecord(path)
    CrashRecord(path)
    first.words[first.take()] = 2
    assert read(path, os.getpid()) == AtWork()
    assert os.listdir(tmp_path) == ["record"]


def test_an_unload_that_is_wanted_is_told_apart(tmp_path: Path) -> None:
    path = str(tmp_path / "record")
    record = CrashRecord(path)
    a, b = names.mark("/a"), names.mark("/b")
    with record.noting(a), record.noting(b, unloading=True):
        assert read(path, os.getpid()) == AtWork(frozenset({a, b}), frozenset({b}))
    assert read(path, os.getpid()) == AtWork()


def test_more_threads_than_words_share_the_last(tmp_path: Path) -> None:
    record = CrashRecord(str(tmp_path / "record"))
    indices: list[int] = []
    take = lambda: indices.extend(record.take() for _ in range(30))  # noqa: E731
    join(*[in_thread(take) for _ in range(20)])
    assert len(set(indices)) == 511
    for index in indices:
        record.give_back(index)
    taken = [record.take() for _ in range(510)]
    assert len(set(taken)) == 510


def test_a_mark_leaves_room_for_the_bit_of_the_unload() -> None:
    marks = {names.mark(f"/nodelet{number}") for number in range(10000)}
    assert len(marks) == 10000
    assert not any(mark % 2 or not 0 < mark < 1 << 64 for mark in marks)
