# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Whose code each thread runs, in a file that outlives the process.

A process that ended by a native crash can no longer say which nodelet was at work. So each thread
that runs code of nodelets notes whose it is, in a word of its own of a small mapped file. The
kernel keeps the file after any end of the process.

The file is an array of 64-bit words. The first is the id of the process, 0 once that has ended in
order; further ones belong to threads and hold the mark of a nodelet (``names.mark``), or 0. A mark
is even: during a requested unload, its last bit is set.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import struct
from dataclasses import dataclass
from typing import Iterator

from dyknow.locks import state_lock

#: Threads with a word of their own; further ones share the last word.
_THREADS = 511
_WORD = struct.Struct("=Q")
_SIZE = (1 + _THREADS) * _WORD.size
_UNLOADING = 1


def as_word(mark: int) -> float:
    """Return the double of the same 64 bits: storing it takes two thirds of the time."""
    word: float = struct.unpack("=d", _WORD.pack(mark))[0]
    return word


class CrashRecord:
    """The words of this process."""

    def __init__(self, path: str = "") -> None:
        """Make the file, in place of an older one; without a path, use memory. Raises OSError."""
        self._lock = state_lock("crash record")
        self._free: list[int] = list(range(_THREADS, 0, -1))
        #: Each is written by the thread that has it, and read by other processes.
        self.words: memoryview[float] = memoryview(_map(path)).cast("d")
        self.words[0] = as_word(os.getpid())

    def take(self) -> int:
        """Reserve a word for this thread; returns its index."""
        with self._lock:
            return self._free.pop() if len(self._free) > 1 else self._free[0]

    def give_back(self, index: int) -> None:
        """Free the word of a thread that ends."""
        with self._lock:
            self.words[index] = 0.0
            if index != self._free[0]:
                self._free.append(index)

    @contextlib.contextmanager
    def noting(self, mark: int, unloading: bool = False) -> Iterator[None]:
        """Note in the block that this thread runs code of a nodelet, or its requested unload."""
        index = self.take()
        self.words[index] = as_word(mark | _UNLOADING if unloading else mark)
        try:
            yield
        finally:
            self.give_back(index)

    def close(self) -> None:
        """Note that the process ends in order, even if nodelets are still at work."""
        self.words[0] = 0.0


@dataclass(frozen=True)
class AtWork:
    """The marks of the nodelets at work at the end of a process, and of those being unloaded."""

    running: frozenset[int] = frozenset()
    unloading: frozenset[int] = frozenset()


def read(path: str, pid: int) -> AtWork:
    """Read which nodelets were at work when a process ended; none if it ended in order.

    Raises:
        OSError: the file cannot be read.
        ValueError: it does not belong to the process.
    """
    with open(path, "rb") as file:
        found = file.read(_SIZE + 1)
    if len(found) != _SIZE:
        raise ValueError(f"'{path}' has not {_SIZE} bytes")
    (process,), *words = _WORD.iter_unpack(found)
    if process == 0:
        return AtWork()
    if process != pid:
        raise ValueError(f"'{path}' is of process {process}")
    marks = [word for (word,) in words if word]
    return AtWork(
        frozenset(mark & ~_UNLOADING for mark in marks),
        frozenset(mark & ~_UNLOADING for mark in marks if mark & _UNLOADING),
    )


def _map(path: str) -> mmap.mmap:
    if not path:
        return mmap.mmap(-1, _SIZE)
    # A new file each time: a process that has the old one mapped may still be about to end.
    new = f"{path}.{os.getpid()}"
    descriptor = os.open(new, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600)
    try:
        os.ftruncate(descriptor, _SIZE)
        os.replace(new, path)
        return mmap.mmap(descriptor, _SIZE)
    finally:
        os.close(descriptor)
