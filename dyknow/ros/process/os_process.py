# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Processes of this machine, identified by their id and the moment of their start.

An id alone may belong to another process by now. The end of a process is noticed at once, also
when it is not a child of this one; how it ended is known of children only.
"""

from __future__ import annotations

import codecs
import contextlib
import fcntl
import functools
import math
import os
import re
import select
import signal
import subprocess
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Callable, Iterator, Mapping, Sequence, TextIO

from dyknow.locks import turn_lock

#: Seconds between two looks, where the kernel does not report the end of a process.
_PERIOD = 0.1
NOTHING: Mapping[str, str] = {}
_POLITELY = (signal.SIGTERM,)
#: States of processes that have ended.
_ENDED = (b"Z", b"X")
#: Seconds for the rest of a session to end after SIGTERM.
_REST_PATIENCE = 1.0
_CHUNK = 1 << 16
#: Bytes at which an output that was copied is cut.
_LONGEST = 10_000_000


@dataclass(frozen=True)
class ProcessId:
    """One process: its id, and the clock ticks between the start of the machine and its own."""

    pid: int
    started: int

    @classmethod
    def of(cls, pid: int) -> ProcessId | None:
        """Look a process up; None if there is none, or if it has ended and waits to be reaped."""
        fields = _stat(pid)
        return None if not fields or fields[0] in _ENDED else cls(pid, int(fields[19]))

    @property
    def alive(self) -> bool:
        """Whether it still runs; a suspended process does."""
        return ProcessId.of(self.pid) == self

    def memory(self) -> int:
        """Return its resident memory in bytes; 0 if it has ended."""
        fields = _stat(self.pid)
        return int(fields[21]) * os.sysconf("SC_PAGE_SIZE") if fields else 0

    def signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.alive:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for its end, at most ``timeout`` seconds; return whether it has ended."""
        ended = self._await_end(timeout)
        _reap(self.pid)
        return ended

    def wait_for_rest(self) -> int | None:
        """Wait for its end without a time limit, then end the rest of its session.

        Returns:
            Its exit code, or the negative number of the signal that ended it; None if it is not a
            child of this process.
        """
        self._await_end(None)
        if ProcessId.of(self.pid) is not None:
            return None  # its id is another process's by now, so nothing of its session is left
        rest = _session(self.pid)  # before it is reaped, as its id is free then
        for process in rest:
            process.signal(signal.SIGTERM)
        deadline = time.monotonic() + _REST_PATIENCE
        for process in rest:
            process.end(max(0.0, deadline - time.monotonic()))
        return _reap(self.pid)

    def end(self, patience: float, signals: Sequence[int] = _POLITELY) -> None:
        """End it with ``signals``, one after the other, and after ``patience`` s with SIGKILL."""
        for number in signals:
            self.signal(number)
            if self.wait(patience / len(signals)):
                return
        self.signal(signal.SIGKILL)
        self.wait()

    def _await_end(self, timeout: float | None) -> bool:
        deadline = math.inf if timeout is None else time.monotonic() + timeout
        descriptor = _pidfd(self.pid)
        if descriptor is None:
            while self.alive and time.monotonic() < deadline:
                time.sleep(_PERIOD)
            return not self.alive
        try:
            if self.alive:
                poll = select.poll()
                poll.register(descriptor, select.POLLIN)
                poll.poll(None if timeout is None else max(0.0, timeout) * 1000)
        finally:
            os.close(descriptor)
        return not self.alive


def only_for_owner(path: str, flags: int) -> int:
    """Open a file; one that is made only its owner may open (an ``opener`` for ``open``)."""
    return os.open(path, flags, 0o600)


def start(
    command: Sequence[str], output: str, folder: str, environment: Mapping[str, str] = NOTHING
) -> ProcessId:
    """Start a process in a session of its own, so that it may outlive this one.

    Args:
        command: program and arguments.
        output: file for its output, which is locked (``flock``) while the process or a child of it
            has it open. Our own output would stay open as long as the process, and a reader of it
            would wait for that long.
        folder: working directory, made if need be; empty for that of this process.
        environment: variables besides those of this process.

    Raises:
        OSError: it cannot be started.
    """
    os.makedirs(folder or ".", exist_ok=True)
    with open(output, "ab") as file:  # appended to: it may be cut meanwhile
        fcntl.flock(file, fcntl.LOCK_SH)
        file.truncate(0)
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            cwd=folder or None,
            env={**os.environ, **environment},
        )
    process.returncode = 0  # ``ProcessId.wait`` reaps it, not ``Popen``
    return ProcessId.of(process.pid) or ProcessId(process.pid, -1)


def is_locked(output: str | Path) -> bool:
    """Whether a process that ``start`` started, or a child of it, still writes to its output."""
    try:
        with open(output, "rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)
    return False


@functools.lru_cache(maxsize=None)
def boot() -> str:
    """Return an id of this boot of the machine; process ids are unique in one boot."""
    try:
        with open("/proc/sys/kernel/random/boot_id") as file:
            return file.read().strip()
    except OSError:
        return ""


def started_with(variable: str) -> list[tuple[ProcessId, str, list[str]]]:
    """Find processes that ``start`` started with a variable, the oldest first.

    Returns for each the variable's value and the command line.
    """
    found = []
    key = variable.encode() + b"="
    # Another process of such a session was forked by one.
    for process, variables, command in _of_this_user(lambda each: os.getsid(each.pid) == each.pid):
        values = (each[len(key) :] for each in variables if each.startswith(key))
        found += [(process, os.fsdecode(each), list(map(os.fsdecode, command))) for each in values]
    return sorted(found, key=lambda each: each[0].started)


def has_begun(command: re.Pattern[bytes], variable: str, seconds: float) -> bool:
    """Whether a process of such a command line has begun in the last seconds.

    It is of this user, and has this process's value of a variable of the environment. Words of the
    command line are separated by zero bytes.
    """
    earliest = time.clock_gettime(time.CLOCK_BOOTTIME) - seconds
    ticks = os.sysconf("SC_CLK_TCK")
    ours = os.fsencode(f"{variable}={os.environ.get(variable, '')}")
    late = _of_this_user(lambda each: each.started / ticks > earliest)
    return any(
        ours in variables and command.search(b"\0".join(words)) for _, variables, words in late
    )


def _of_this_user(
    is_wanted: Callable[[ProcessId], bool],
) -> Iterator[tuple[ProcessId, list[bytes], list[bytes]]]:
    """Yield those of the user's processes that are wanted, with environment and command line."""
    for process in filter(None, map(ProcessId.of, _pids())):
        with contextlib.suppress(OSError):  # it has ended, or is another user's
            if is_wanted(process):
                variables, words = (_words(process.pid, file) for file in ("environ", "cmdline"))
                yield process, variables, words


# /proc itself, not psutil: that knows the start of a process only as a time of day, which moves
# when the clock is set.


def _pids() -> list[int]:
    return [int(entry) for entry in os.listdir("/proc") if entry.isdigit()]


def _words(pid: int, file: str) -> list[bytes]:
    with open(f"/proc/{pid}/{file}", "rb") as opened:
        return opened.read().split(b"\0")


def _stat(pid: int) -> list[bytes]:
    """Fields of a process from its state on; empty if it does not exist."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:
            # The second field is the program's name, in brackets, with anything in it.
            return file.read().rpartition(b")")[2].split()
    except OSError:
        return []


def _session(leader: int) -> list[ProcessId]:
    """Processes of the session that a process began, without itself."""
    fields = {pid: _stat(pid) for pid in _pids() if pid != leader}
    return [
        ProcessId(pid, int(each[19]))
        for pid, each in fields.items()
        if each and int(each[3]) == leader and each[0] not in _ENDED
    ]


def _pidfd(pid: int) -> int | None:
    try:
        return int(getattr(os, "pidfd_open")(pid))  # noqa: B009
    except (AttributeError, OSError):  # before Python 3.9, or no such process
        return None


def _reap(pid: int) -> int | None:
    """Return the status of a child that has ended, as ``wait_for_rest`` does; else None."""
    try:
        reaped, status = os.waitpid(pid, os.WNOHANG)
    except ChildProcessError:
        return None  # not a child of this process
    if not reaped:
        return None
    return -os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.WEXITSTATUS(status)


class LogTail:
    """Copies additions to the output of a process, and cuts it when it is long; thread-safe."""

    def __init__(self, path: str, at_end: bool = False) -> None:
        """Start at the beginning of ``path``, or at its present end."""
        self._path = path
        self._turn = turn_lock("output of a child")
        #: Keeps the beginning of a character whose end has yet to come.
        self._decode = codecs.getincrementaldecoder("utf-8")("replace").decode
        self._position = os.path.getsize(path) if at_end and os.path.exists(path) else 0

    def copy(self, target: TextIO) -> None:
        """Copy the additions since the last call."""
        with self._turn:
            try:
                with open(self._path, "rb") as file:
                    file.seek(self._position)
                    for chunk in iter(partial(file.read, _CHUNK), b""):
                        self._position += len(chunk)
                        target.write(self._decode(chunk))
                target.flush()
                if self._position > _LONGEST:
                    os.truncate(self._path, 0)
                    self._position = 0
            except (OSError, ValueError):
                return  # the file is gone, or our own output closed
